"""The compressed system's equation of motion in compiled code."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numba import njit

from dpc_ros.autoencoder import compiled
from dpc_ros.autoencoder.compiled import FIRST_TANGENT, SECOND, VALUE, value_and_derivatives
from dpc_ros.network import kernels


def _compile(sources: str) -> Callable:
    """Return the kernel; `sources` enters the key under which numba keeps it on disk.

    numba looks only at the file of the function that it is asked for, but the kernel contains
    functions of other files: a change of those would be passed over.
    """

    @njit(cache=True)
    def accelerations(decoder, network, gravity, place, latent, velocity, force):
        sources  # noqa: B018
        result = np.empty_like(latent)
        for row in range(latent.shape[0]):
            result[row] = _acceleration(
                decoder, network, gravity, place, latent[row], velocity[row], force[row]
            )
        return result

    return accelerations


@njit
def _acceleration(decoder, network, gravity, place, latent, velocity, force):
    """ξ̈ = M_η⁻¹JᵀM(q̈ − J̇ξ̇), (m,), with q̈ the body's own acceleration at (D(ξ), Jξ̇).

    `place` is the first of the two coordinates of the actuated mass, which carries `force`, (2,)
    [N]. `velocity` is ξ̇.
    """
    m = latent.shape[0]
    rows = value_and_derivatives(decoder, latent, velocity)
    tangents = rows[FIRST_TANGENT : FIRST_TANGENT + m]
    n = rows.shape[1]
    full_velocity = np.zeros(n)
    for a in range(m):
        full_velocity += velocity[a] * tangents[a]
    full_force = np.zeros(n)
    full_force[place : place + 2] = force
    difference = (
        kernels.acceleration(network, gravity, rows[VALUE], full_velocity, full_force)
        - rows[SECOND]
    )
    mass_matrix = np.empty((m, m))
    right = np.empty(m)
    weighted = np.empty(n)
    for a in range(m):
        for i in range(n):
            weighted[i] = network.mobile_mass[i // 2] * tangents[a, i]
        right[a] = _dot(weighted, difference)
        for b in range(a, m):
            mass_matrix[a, b] = mass_matrix[b, a] = _dot(weighted, tangents[b])
    return np.linalg.solve(mass_matrix, right)


@njit(fastmath={'contract', 'reassoc'})
def _dot(a, b):
    total = 0.0
    for i in range(a.shape[0]):
        total += a[i] * b[i]
    return total


SOURCES = [Path(str(module.__file__)) for module in (compiled, kernels)]
accelerations = _compile(hashlib.sha256(b''.join(p.read_bytes() for p in SOURCES)).hexdigest())
