"""Autoencoders that other packages register: any torch module with `encode` and `decode`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from dpc_ros.autoencoder.architecture import PluginArchitecture
from dpc_ros.autoencoder.base import Autoencoder, Derivatives
from dpc_ros.autoencoder.kinds import load_plugin
from dpc_ros.autoencoder.module import AutoencoderModule


class PluginModule(AutoencoderModule):
    """A registered module with normalisation and optional skip around it.

    Raises:
        ValueError: its class is not registered, does not take the options, or gives no torch
            module with `encode` and `decode` between the right shapes.
    """

    architecture: PluginArchitecture

    def __init__(self, architecture: PluginArchitecture) -> None:
        super().__init__(architecture)
        n, m = architecture.configuration_size, architecture.latent_size
        plugin = load_plugin(architecture.kind)
        try:
            self.plugin = plugin(n, m, **architecture.options)
        except Exception as error:  # whatever goes wrong in code that is not ours
            raise ValueError(f'kind {architecture.kind!r}: {error}') from error
        _check_maps(architecture, self.plugin)

    def encoder(self, x: Tensor) -> Tensor:
        """Return the plug-in's raw latents."""
        return self.plugin.encode(x)

    def decoder(self, latent: Tensor) -> Tensor:
        """Return the plug-in's normalised configurations."""
        return self.plugin.decode(latent)

    def export(self) -> PluginAutoencoder:
        """Return the same maps for online use."""
        return PluginAutoencoder.from_tensors(self.architecture, self.tensors())


class PluginAutoencoder(Autoencoder):
    """A registered module in float64, its derivatives by automatic differentiation."""

    def __init__(self, module: PluginModule) -> None:
        self._module = module.double().eval().requires_grad_(False)

    @classmethod
    def from_tensors(
        cls, architecture: PluginArchitecture, tensors: Mapping[str, np.ndarray]
    ) -> PluginAutoencoder:
        """Return a `PluginModule` with these weights, for online use.

        Raises:
            ValueError: a tensor is missing or unknown, has another shape, or is a scale that is
                not positive, or the plug-in is not what it should be.
        """
        with torch.random.fork_rng(devices=[]):  # initial weights, which nobody will see
            module = PluginModule(architecture)
        try:
            module.load_state_dict({k: torch.from_numpy(v.copy()) for k, v in tensors.items()})
        except RuntimeError as error:
            raise ValueError(' '.join(str(error).split())) from error
        for name in ('configuration_scale', 'latent_scale', 'pod_scale'):
            scale = getattr(module, name)
            if not (scale > 0).all():
                raise ValueError(f'{name}: expected positive values, got {scale.tolist()}')
        return cls(module)

    @property
    def configuration_size(self) -> int:
        return self._module.architecture.configuration_size

    @property
    def latent_size(self) -> int:
        return self._module.architecture.latent_size

    def encode(self, configuration: Float[np.ndarray, '*batch n']) -> Float[np.ndarray, '*batch m']:
        rows = _tensor(configuration.reshape(-1, self.configuration_size))
        return self._module.encode(rows).numpy().reshape(*configuration.shape[:-1], -1)

    def decode(self, latent: Float[np.ndarray, '*batch m']) -> Float[np.ndarray, '*batch n']:
        rows = _tensor(latent.reshape(-1, self.latent_size))
        return self._module.decode(rows).numpy().reshape(*latent.shape[:-1], -1)

    def encoder_jacobian_vector_product(
        self,
        configuration: Float[np.ndarray, ' n'],
        velocity: Float[np.ndarray, ' n'],
        guess: Float[np.ndarray, ' m'] | None = None,
    ) -> tuple[Float[np.ndarray, ' m'], Float[np.ndarray, ' m']]:
        point, tangent = _tensor(configuration), _tensor(velocity)
        moved = torch.func.jvp(lambda q: self._module.encode(q[None])[0], (point,), (tangent,))
        return moved[0].numpy(), moved[1].numpy()

    def decode_with_jacobian(
        self, latent: Float[np.ndarray, '*batch m']
    ) -> tuple[Float[np.ndarray, '*batch n'], Float[np.ndarray, '*batch n m']]:
        rows = _tensor(latent.reshape(-1, self.latent_size))
        jacobian = torch.func.vmap(torch.func.jacfwd(self._decode_one))(rows).numpy()
        return self.decode(latent), jacobian.reshape(*latent.shape[:-1], *jacobian.shape[1:])

    def decode_with_derivatives(
        self,
        latent: Float[np.ndarray, '*batch m'],
        latent_velocity: Float[np.ndarray, '*batch m'],
    ) -> Derivatives:
        decoded, jacobian = self.decode_with_jacobian(latent)
        rows = _tensor(latent.reshape(-1, self.latent_size))
        tangents = _tensor(latent_velocity.reshape(-1, self.latent_size))

        def velocity(xi: Tensor) -> Tensor:
            return torch.func.jvp(self._module.decode, (xi,), (tangents,))[1]

        second = torch.func.jvp(velocity, (rows,), (tangents,))[1]
        return decoded, jacobian, second.numpy().reshape(decoded.shape)

    def decoder_curvature(
        self, latent: Float[np.ndarray, ' m'], weight: Float[np.ndarray, ' n']
    ) -> Float[np.ndarray, 'm m']:
        weights = _tensor(weight)
        hessian = torch.func.hessian(lambda xi: weights @ self._decode_one(xi))
        return hessian(_tensor(latent)).numpy()

    def _decode_one(self, latent: Tensor) -> Tensor:
        return self._module.decode(latent[None])[0]


def _tensor(array: Float[np.ndarray, '*shape']) -> Tensor:
    # A copy: torch takes no array that is read-only or runs backwards.
    return torch.from_numpy(np.array(array, float))


def _check_maps(architecture: PluginArchitecture, plugin: object) -> None:
    kind, n, m = architecture.kind, architecture.configuration_size, architecture.latent_size
    if not isinstance(plugin, torch.nn.Module):
        raise ValueError(f'kind {kind!r}: expected a torch module, got a {type(plugin).__name__}')
    for name, inputs, outputs in (('encode', n, m), ('decode', m, n)):
        if not callable(getattr(plugin, name, None)):
            raise ValueError(f'kind {kind!r}: its module has no method {name!r}')
        expected = f'kind {kind!r}: {name} should map (batch, {inputs}) to (batch, {outputs})'
        try:
            with torch.no_grad():
                shape = tuple(getattr(plugin, name)(torch.zeros(2, inputs)).shape)
        except (AttributeError, IndexError, RuntimeError, TypeError, ValueError) as error:
            raise ValueError(f'{expected}, but (2, {inputs}) gives: {error}') from error
        if shape != (2, outputs):
            raise ValueError(f'{expected}, but (2, {inputs}) became {shape}')
