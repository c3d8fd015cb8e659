"""The flat autoencoder as a torch module: what is trained, and its export for online use."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from dpc_ros.autoencoder.flat import FlatAutoencoder
from dpc_ros.autoencoder.perceptron import Layer, Perceptron

_ACTIVATION_MODULES = {'elu': nn.ELU, 'silu': nn.SiLU}
_SMALLEST_SCALE = 1e-12


@dataclass(frozen=True)
class FlatArchitecture:
    """Sizes and kind of a flat autoencoder; the paper's defaults (section A.2).

    Attributes:
        configuration_size: n.
        latent_size: m.
        hidden_sizes: units of the encoder's hidden layers; the decoder mirrors them.
        activation: σ between layers.
        skip: centre and scale the data, and add linear POD maps around encoder and decoder, so
            that the networks learn only what POD leaves over.

    Raises:
        ValueError: a size is not positive, or the activation is unknown.
    """

    configuration_size: int
    latent_size: int
    hidden_sizes: tuple[int, ...] = (300, 200, 100)
    activation: str = 'elu'
    skip: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, 'hidden_sizes', tuple(self.hidden_sizes))
        sizes = (self.configuration_size, self.latent_size, *self.hidden_sizes)
        if not all(isinstance(size, int) and size > 0 for size in sizes):
            raise ValueError(f'architecture: expected positive whole sizes, got {sizes}')
        if self.activation not in _ACTIVATION_MODULES:
            raise ValueError(
                f'activation {self.activation!r}: expected one of {sorted(_ACTIVATION_MODULES)}'
            )


class FlatModule(nn.Module):
    """E(q) and D(ξ) with x = (q − mean)/scale: ξ = (f_E(x) + P⁺x − c)/s, x̂ = f_D(sξ + c) + P(sξ + c).

    f_E and f_D are perceptrons, P the scaled POD basis (zero without skip), c and s centre and
    scale of the latents, which `normalise_latents` sets after training.
    """

    def __init__(self, architecture: FlatArchitecture) -> None:
        super().__init__()
        self.architecture = architecture
        n, m = architecture.configuration_size, architecture.latent_size
        sizes = [n, *architecture.hidden_sizes, m]
        self.encoder = _perceptron_module(sizes, architecture.activation)
        self.decoder = _perceptron_module(sizes[::-1], architecture.activation)
        for name, value in {
            'configuration_mean': torch.zeros(n, dtype=torch.float64),
            'configuration_scale': torch.ones((), dtype=torch.float64),
            'latent_mean': torch.zeros(m, dtype=torch.float64),
            'latent_scale': torch.ones(m, dtype=torch.float64),
            'pod_basis': torch.zeros(n, m if architecture.skip else 0, dtype=torch.float64),
            'pod_scale': torch.ones(m if architecture.skip else 0, dtype=torch.float64),
        }.items():
            self.register_buffer(name, value)

    def fit_normalisation(self, configurations: Float[np.ndarray, 'frames n']) -> None:
        """Set mean, scale and POD basis from the training configurations."""
        mean = configurations.mean(axis=0)
        scale = (configurations - mean).std()
        _, singular_values, directions = np.linalg.svd(
            (configurations - mean) / scale, full_matrices=False
        )
        m = self.architecture.latent_size
        self.configuration_mean.copy_(torch.from_numpy(mean))
        self.configuration_scale.fill_(scale)
        self.pod_basis.copy_(torch.from_numpy(directions[:m].T))
        self.pod_scale.copy_(torch.from_numpy(singular_values[:m] / np.sqrt(len(configurations))))

    def encode(self, configuration: Tensor) -> Tensor:
        """Return ξ, (batch, m), of configurations, (batch, n)."""
        x = (configuration - self.configuration_mean) / self.configuration_scale
        x = x.to(configuration.dtype)
        raw = self.encoder(x)
        if self.architecture.skip:
            raw = raw + x @ (self.pod_basis / self.pod_scale).to(x.dtype)
        return (raw - self.latent_mean.to(x.dtype)) / self.latent_scale.to(x.dtype)

    def decode(self, latent: Tensor) -> Tensor:
        """Return configurations, (batch, n), of latents, (batch, m)."""
        dtype = latent.dtype
        raw = latent * self.latent_scale.to(dtype) + self.latent_mean.to(dtype)
        x = self.decoder(raw)
        if self.architecture.skip:
            x = x + raw @ (self.pod_basis * self.pod_scale).T.to(dtype)
        return (x * self.configuration_scale + self.configuration_mean).to(dtype)

    def forward(self, configuration: Tensor) -> Tensor:
        """Return the reconstruction D(E(q))."""
        return self.decode(self.encode(configuration))

    @torch.no_grad()
    def normalise_latents(self, configurations: Float[np.ndarray, 'frames n']) -> None:
        """Give every latent zero mean and unit deviation over the training configurations.

        The reconstruction does not change; control gains per latent unit become comparable.
        """
        self.latent_mean.zero_()
        self.latent_scale.fill_(1.0)
        raw = self.export().encode(configurations)
        self.latent_mean.copy_(torch.from_numpy(raw.mean(axis=0)))
        scale = np.maximum(raw.std(axis=0), _SMALLEST_SCALE)
        self.latent_scale.copy_(torch.from_numpy(scale))

    @torch.no_grad()
    def export(self) -> FlatAutoencoder:
        """Return the same maps in float64, every normalisation folded into the layers."""
        mean, scale = _array(self.configuration_mean), float(self.configuration_scale)
        latent_mean, latent_scale = _array(self.latent_mean), _array(self.latent_scale)
        activation = self.architecture.activation
        encoder, decoder = _layers(self.encoder), _layers(self.decoder)
        encoder_skip = decoder_skip = None
        encoder_offset, decoder_offset = -latent_mean, np.zeros_like(mean)
        if self.architecture.skip:
            basis, pod_scale = _array(self.pod_basis), _array(self.pod_scale)
            inward = (basis / pod_scale).T
            outward = basis * pod_scale
            encoder_skip = inward / scale / latent_scale[:, None]
            encoder_offset = encoder_offset - inward @ (mean / scale)
            decoder_skip = scale * outward * latent_scale
            decoder_offset = scale * outward @ latent_mean
        first = encoder[0]
        encoder[0] = Layer(first.weight / scale, first.bias - first.weight @ (mean / scale))
        last = encoder[-1]
        encoder[-1] = Layer(
            last.weight / latent_scale[:, None], (last.bias + encoder_offset) / latent_scale
        )
        first = decoder[0]
        decoder[0] = Layer(first.weight * latent_scale, first.bias + first.weight @ latent_mean)
        last = decoder[-1]
        decoder[-1] = Layer(scale * last.weight, scale * last.bias + mean + decoder_offset)
        return FlatAutoencoder(
            Perceptron(encoder, activation, encoder_skip),
            Perceptron(decoder, activation, decoder_skip),
        )


def _perceptron_module(sizes: list[int], activation: str) -> nn.Sequential:
    modules: list[nn.Module] = []
    for inputs, outputs in zip(sizes, sizes[1:], strict=False):
        modules += [nn.Linear(inputs, outputs), _ACTIVATION_MODULES[activation]()]
    return nn.Sequential(*modules[:-1])


def _layers(module: nn.Sequential) -> list[Layer]:
    return [
        Layer(_array(part.weight), _array(part.bias))
        for part in module
        if isinstance(part, nn.Linear)
    ]


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().to(torch.float64).cpu().numpy().copy()
