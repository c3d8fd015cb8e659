"""Dense autoencoders in compiled code: value and derivatives at one point, in float64.

One pass moves several rows through the layers. Of a decoder: the value, the second derivative along
the latent velocity, and a tangent for each latent; rows and units stand in blocks of four, filled
up by zeros, so that a weight is loaded once for sixteen products. Of an encoder: the value and one
tangent, in which a weight is loaded once for both.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numba import njit

_BLOCK = 4
VALUE, SECOND, FIRST_TANGENT = 0, 1, 2  # rows


class DenseDecoder(NamedTuple):
    """What the kernel needs of D(ξ) = Sξ + W_L σ(… σ(W₁ξ + b₁) …) + b_L.

    Attributes:
        weights: W_lᵀ, each with zeros up to whole blocks of inputs and hidden outputs.
        biases: b_l, likewise.
        skip: Sᵀ, zeros where there is no skip.
        silu: σ is SiLU, else ELU.
    """

    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    skip: np.ndarray
    silu: bool


class DenseEncoder(NamedTuple):
    """What the kernel needs of E(q) = Sq + W_L σ(… σ(W₁q + b₁) …) + b_L.

    Attributes:
        inputs: size of q.
        weights: W_lᵀ, each with zeros up to whole blocks of inputs and hidden outputs.
        biases: b_l, likewise.
        skip: Sᵀ, likewise, zeros where there is no skip.
        silu: σ is SiLU, else ELU.
    """

    inputs: int
    weights: tuple[np.ndarray, ...]
    biases: tuple[np.ndarray, ...]
    skip: np.ndarray
    silu: bool


def dense_encoder(
    weights: Sequence[Float[np.ndarray, 'outputs inputs']],
    biases: Sequence[Float[np.ndarray, ' outputs']],
    skip: Float[np.ndarray, 'm n'] | None,
    activation: str,
) -> DenseEncoder:
    """Return an encoder for the kernel; see `dense_decoder`, whose layers go the other way."""
    return DenseEncoder(weights[0].shape[1], *dense_decoder(weights, biases, skip, activation))


def dense_decoder(
    weights: Sequence[Float[np.ndarray, 'outputs inputs']],
    biases: Sequence[Float[np.ndarray, ' outputs']],
    skip: Float[np.ndarray, 'n m'] | None,
    activation: str,
) -> DenseDecoder:
    """Return a decoder for the kernel.

    Args:
        weights: of each layer, from the latents to the configuration.
        biases: of each layer.
        skip: linear map beside the layers, or none.
        activation: `elu` or `silu`, between the layers.

    Raises:
        ValueError: the activation is another.
    """
    if activation not in ('elu', 'silu'):
        raise ValueError(f'activation {activation!r}: expected elu or silu in compiled code')
    n, m = len(biases[-1]), weights[0].shape[1]
    hidden = [_in_blocks(len(bias)) for bias in biases[:-1]]
    outputs = [*hidden, n]
    inputs = [_in_blocks(m), *hidden]
    return DenseDecoder(
        weights=tuple(
            _filled(weight.T, shape)
            for weight, shape in zip(weights, zip(inputs, outputs, strict=True), strict=True)
        ),
        biases=tuple(_filled(bias, (size,)) for bias, size in zip(biases, outputs, strict=True)),
        skip=_filled(np.zeros((m, n)) if skip is None else skip.T, (_in_blocks(m), n)),
        silu=activation == 'silu',
    )


def _filled(array: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Return an array with zeros behind each of its axes."""
    filled = np.zeros(shape)
    filled[tuple(slice(size) for size in array.shape)] = array
    return filled


@njit(cache=True)
def _in_blocks(size):
    return -(-size // _BLOCK) * _BLOCK


@njit(cache=True)
def value_and_derivatives(decoder, latent, velocity):
    """Return D(ξ), J̇ξ̇ and the columns of J as rows, (2 + m or more, n).

    Row `VALUE` is D(ξ), row `SECOND` the second derivative along the velocity, the rows from
    `FIRST_TANGENT` on are ∂D/∂ξ_a; what comes after them are zeros.
    """
    m = latent.shape[0]
    entered = np.zeros((_in_blocks(FIRST_TANGENT + m), decoder.skip.shape[0]))
    entered[VALUE, :m] = latent
    for a in range(m):
        entered[FIRST_TANGENT + a, a] = 1.0
    moved = entered
    last = len(decoder.weights) - 1
    for layer in range(last + 1):
        weight = decoder.weights[layer]
        left = np.zeros((moved.shape[0], weight.shape[1]))
        left[VALUE] = decoder.biases[layer]
        _add_product(left, moved, weight)
        if layer < last:
            _bend(left, velocity, decoder.silu)
        else:
            _add_product(left, entered, decoder.skip)
        moved = left
    return moved


@njit(cache=True, fastmath={'contract'})
def _add_product(out, x, weight):
    """Add x·W to the rows of `out`, four rows and four inputs at a time."""
    outputs = weight.shape[1]
    for k in range(0, weight.shape[0], _BLOCK):
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        for r in range(0, x.shape[0], _BLOCK):
            out0, out1, out2, out3 = out[r], out[r + 1], out[r + 2], out[r + 3]
            a0, a1, a2, a3 = x[r, k], x[r, k + 1], x[r, k + 2], x[r, k + 3]
            b0, b1, b2, b3 = x[r + 1, k], x[r + 1, k + 1], x[r + 1, k + 2], x[r + 1, k + 3]
            c0, c1, c2, c3 = x[r + 2, k], x[r + 2, k + 1], x[r + 2, k + 2], x[r + 2, k + 3]
            d0, d1, d2, d3 = x[r + 3, k], x[r + 3, k + 1], x[r + 3, k + 2], x[r + 3, k + 3]
            for j in range(outputs):
                # Loaded before the first store, behind which the compiler would load them again.
                v0, v1, v2, v3 = w0[j], w1[j], w2[j], w3[j]
                out0[j] += (v0 * a0 + v1 * a1) + (v2 * a2 + v3 * a3)
                out1[j] += (v0 * b0 + v1 * b1) + (v2 * b2 + v3 * b3)
                out2[j] += (v0 * c0 + v1 * c1) + (v2 * c2 + v3 * c3)
                out3[j] += (v0 * d0 + v1 * d1) + (v2 * d2 + v3 * d3)


@njit(cache=True)
def _bend(rows, velocity, silu):
    """Put σ between two layers: σ(z), σ'(z) on what is linear, and σ''(z)ż² on the second."""
    units = rows.shape[1]
    slope, bend, along = np.empty(units), np.empty(units), np.zeros(units)
    for a in range(velocity.shape[0]):
        along += velocity[a] * rows[FIRST_TANGENT + a]
    value = rows[VALUE]
    for i in range(units):
        value[i], slope[i], bend[i] = _silu(value[i]) if silu else _elu(value[i])
    for r in range(SECOND, FIRST_TANGENT + velocity.shape[0]):
        rows[r] *= slope
    rows[SECOND] += bend * along * along


@njit(cache=True)
def _silu(z):
    """Return σ(z), σ'(z), σ''(z) of z/(1 + e⁻ᶻ)."""
    s = 1.0 / (1.0 + math.exp(-z))
    rest = 1.0 - s
    return z * s, s * (1.0 + z * rest), s * rest * (2.0 + z * (rest - s))


@njit(cache=True)
def _elu(z):
    """Return σ(z), σ'(z), σ''(z) of z for z > 0, else eᶻ − 1."""
    if z > 0.0:
        return z, 1.0, 0.0
    slope = math.exp(z)
    return slope - 1.0, slope, slope


def value_and_product(
    encoder: DenseEncoder,
    configuration: Float[np.ndarray, ' n'],
    velocity: Float[np.ndarray, ' n'],
) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
    """Return E(q) and J_E(q) q̇.

    Raises:
        ValueError: q or q̇ has another size.
    """
    rows = np.zeros((2, len(encoder.skip)))  # and so the kernel knows one kind of array alone
    rows[0, : encoder.inputs] = configuration
    rows[1, : encoder.inputs] = velocity
    value, product = _move_pair(encoder, rows)
    return value, product


@njit(cache=True)
def _move_pair(encoder, entered):
    moved = entered
    last = len(encoder.weights) - 1
    for layer in range(last + 1):
        weight = encoder.weights[layer]
        left = np.zeros((2, weight.shape[1]))
        left[0] = encoder.biases[layer]
        _add_product_of_pair(left, moved, weight)
        if layer < last:
            value, tangent = left[0], left[1]
            for i in range(weight.shape[1]):
                value[i], slope, _ = _silu(value[i]) if encoder.silu else _elu(value[i])
                tangent[i] *= slope
        else:
            _add_product_of_pair(left, entered, encoder.skip)
        moved = left
    return moved


@njit(cache=True, fastmath={'contract'})
def _add_product_of_pair(out, x, weight):
    """Add x·W to the two rows of `out`, four inputs at a time."""
    outputs = weight.shape[1]
    out0, out1 = out[0], out[1]
    for k in range(0, weight.shape[0], _BLOCK):
        w0, w1, w2, w3 = weight[k], weight[k + 1], weight[k + 2], weight[k + 3]
        a0, a1, a2, a3 = x[0, k], x[0, k + 1], x[0, k + 2], x[0, k + 3]
        b0, b1, b2, b3 = x[1, k], x[1, k + 1], x[1, k + 2], x[1, k + 3]
        for j in range(outputs):
            v0, v1, v2, v3 = w0[j], w1[j], w2[j], w3[j]
            out0[j] += (v0 * a0 + v1 * a1) + (v2 * a2 + v3 * a3)
            out1[j] += (v0 * b0 + v1 * b1) + (v2 * b2 + v3 * b3)
