"""The flat autoencoder as a torch module: what is trained, and its export for online use."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.flat import FlatAutoencoder

_ACTIVATION_MODULES = {'elu': nn.ELU, 'silu': nn.SiLU}
_SMALLEST_SCALE = 1e-12


class FlatModule(nn.Module):
    """ξ = (f_E(x) + P⁺x − c)/s and x̂ = f_D(r) + Pr, with x = (q − mean)/scale and r = sξ + c.

    f_E and f_D are perceptrons, P the scaled POD basis (zero without skip), c and s centre and
    scale of the latents, which `normalise_latents` sets after training.
    """

    configuration_mean: Tensor
    configuration_scale: Tensor
    latent_mean: Tensor
    latent_scale: Tensor
    pod_basis: Tensor
    pod_scale: Tensor

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

    def tensors(self) -> dict[str, np.ndarray]:
        """Return every weight and buffer by its name, as a checkpoint stores them."""
        return {key: value.detach().cpu().numpy() for key, value in self.state_dict().items()}

    def export(self) -> FlatAutoencoder:
        """Return the same maps for online use."""
        return FlatAutoencoder.from_tensors(self.architecture, self.tensors())


def _perceptron_module(sizes: list[int], activation: str) -> nn.Sequential:
    modules: list[nn.Module] = []
    for inputs, outputs in pairwise(sizes):
        modules += [nn.Linear(inputs, outputs), _ACTIVATION_MODULES[activation]()]
    return nn.Sequential(*modules[:-1])
