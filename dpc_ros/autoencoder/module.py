"""What every autoencoder has while it is trained in torch: normalisation, skip, export."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn

from dpc_ros.autoencoder.base import Autoencoder

_SMALLEST_SCALE = 1e-12


class AutoencoderModule(nn.Module, ABC):
    """ξ = (f_E(x) + P⁺x − c)/s and x̂ = f_D(r) + Pr, with x = (q − mean)/scale and r = sξ + c.

    f_E and f_D are the networks `encoder` and `decoder` of a subclass, P the scaled POD basis
    (zero without skip), c and s centre and scale of the latents, which `normalise_latents` sets
    after training. With `pod_size` the networks see the first POD coordinates of x only.

    What the networks see is called features below: x or its POD coordinates, in which the loss is
    the same but for the part that the modes left out would add.
    """

    configuration_mean: Tensor
    configuration_scale: Tensor
    latent_mean: Tensor
    latent_scale: Tensor
    pod_basis: Tensor
    pod_scale: Tensor
    encoder: Any
    decoder: Any

    def __init__(self, architecture: Any) -> None:
        super().__init__()
        self.architecture = architecture
        n, m, modes = (
            architecture.configuration_size,
            architecture.latent_size,
            architecture.basis_size,
        )
        for name, value in {
            'configuration_mean': torch.zeros(n, dtype=torch.float64),
            'configuration_scale': torch.ones((), dtype=torch.float64),
            'latent_mean': torch.zeros(m, dtype=torch.float64),
            'latent_scale': torch.ones(m, dtype=torch.float64),
            'pod_basis': torch.zeros(n, modes, dtype=torch.float64),
            'pod_scale': torch.ones(modes, dtype=torch.float64),
        }.items():
            self.register_buffer(name, value)

    def fit_normalisation(self, configurations: Float[np.ndarray, 'frames n']) -> None:
        """Set mean, scale and POD basis from the training configurations, if they are used.

        Raises:
            ValueError: the configurations have fewer directions than the basis has modes.
        """
        if not self.architecture.skip:
            return
        mean = configurations.mean(axis=0)
        centred = configurations - mean
        scale = centred.std()
        modes = self.architecture.basis_size
        variances, directions = np.linalg.eigh(centred.T @ centred / len(configurations))
        variances, directions = variances[::-1][:modes], directions[:, ::-1][:, :modes]
        if not (variances > _SMALLEST_SCALE * scale**2).all():
            raise ValueError(
                f'the training configurations have fewer than {modes} independent directions: '
                'train on more of them, or with fewer latent or POD coordinates'
            )
        self.configuration_mean.copy_(torch.from_numpy(mean))
        self.configuration_scale.fill_(scale)
        self.pod_basis.copy_(torch.from_numpy(directions.copy()))
        self.pod_scale.copy_(torch.from_numpy(np.sqrt(variances) / scale))

    def features(self, configuration: Tensor) -> Tensor:
        """Return what the networks see of configurations, (batch, n), in their precision."""
        x = (configuration - self.configuration_mean) / self.configuration_scale
        if self.architecture.pod_size:
            x = x @ self.pod_basis
        return x.to(configuration.dtype)

    def lost_by_features(self, configuration: Tensor) -> float:
        """Return the mean square of what the features leave out of configurations [m²]."""
        if not self.architecture.pod_size:
            return 0.0
        x = (configuration - self.configuration_mean) / self.configuration_scale
        lost = x - (x @ self.pod_basis) @ self.pod_basis.T
        return float((lost**2).mean() * self.configuration_scale**2)

    def reconstruct(self, features: Tensor) -> Tensor:
        """Return the features that come back through the latents."""
        return self._decode_to_features(self._encode_features(features))

    def encode(self, configuration: Tensor) -> Tensor:
        """Return ξ, (batch, m), of configurations, (batch, n)."""
        return self._encode_features(self.features(configuration))

    def decode(self, latent: Tensor) -> Tensor:
        """Return configurations, (batch, n), of latents, (batch, m)."""
        x = self._decode_to_features(latent)
        if self.architecture.pod_size:
            x = x @ self.pod_basis.T.to(x.dtype)
        return (x * self.configuration_scale + self.configuration_mean).to(latent.dtype)

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

    @abstractmethod
    def export(self) -> Autoencoder:
        """Return the same maps for online use."""

    def _encode_features(self, x: Tensor) -> Tensor:
        raw = self.encoder(x)
        if self.architecture.skip:
            m = self.architecture.latent_size
            scale = self.pod_scale[:m].to(x.dtype)
            modes = x[:, :m] if self.architecture.pod_size else x @ self.pod_basis.to(x.dtype)
            raw = raw + modes / scale
        return (raw - self.latent_mean.to(x.dtype)) / self.latent_scale.to(x.dtype)

    def _decode_to_features(self, latent: Tensor) -> Tensor:
        dtype = latent.dtype
        raw = latent * self.latent_scale.to(dtype) + self.latent_mean.to(dtype)
        x = self.decoder(raw)
        if self.architecture.skip:
            m = self.architecture.latent_size
            modes = raw * self.pod_scale[:m].to(dtype)
            if self.architecture.pod_size:
                x = x + nn.functional.pad(modes, (0, self.architecture.pod_size - m))
            else:
                x = x + modes @ self.pod_basis.T.to(dtype)
        return x
