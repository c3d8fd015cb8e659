"""The latent right-hand side ξ̈ of a dense decoder: ours compiled beside torch's autograd.

The peer is what a user writes with torch.func in double precision: decoder, Jacobian by forward
mode, J̇ξ̇ as a jvp of a jvp, the body's forces by torch, a solve. Decoders: the paper's sizes
5-100-200-300-400 with random weights, and the shipped one of ours.
"""

import numpy as np
import torch
from side_by_side import row, side_by_side

from dpc_ros.autoencoder import load_checkpoint
from dpc_ros.autoencoder.architecture import FlatArchitecture
from dpc_ros.autoencoder.flat_module import FlatModule
from dpc_ros.network import Gravity, Mechanics, load_network
from dpc_ros.reduction import CompressedSystem

REPETITIONS = 30
CALLS = 20  # at a stretch


class TorchSystem:
    """The compressed system in torch."""

    def __init__(self, mechanics, module):
        network = mechanics.network
        self.module = module.double().eval().requires_grad_(False)
        self.mass = torch.from_numpy(mechanics.mass_diagonal)
        self.gravity = torch.from_numpy(np.tile(mechanics.gravity_vector, len(network.mobile)))
        arrays = mechanics.arrays
        self.ends = torch.from_numpy(arrays.first), torch.from_numpy(arrays.second)
        self.fixed = torch.tensor(arrays.fixed_position)
        self.stiffness = torch.tensor(arrays.stiffness)
        self.rest_length = torch.tensor(arrays.rest_length)
        self.damping = torch.tensor(arrays.damping)[:, None]
        self.background = torch.tensor(arrays.background_vector.T)
        self.background_stiffness = arrays.background_stiffness

    def decode(self, latent):
        return self.module.decode(latent[None])[0]

    def acceleration(self, latent, velocity):
        decoded = self.decode(latent)
        jacobian = torch.func.jacfwd(self.decode)(latent)
        moved = torch.func.jvp(
            lambda xi: torch.func.jvp(self.decode, (xi,), (velocity,))[1], (latent,), (velocity,)
        )[1]
        difference = self.body_acceleration(decoded, jacobian @ velocity) - moved
        weighted = self.mass[:, None] * jacobian
        return torch.linalg.solve(jacobian.T @ weighted, weighted.T @ difference)

    def body_acceleration(self, configuration, velocity):
        first, second = self.ends
        position = torch.cat([configuration.view(-1, 2), self.fixed])
        moving = torch.cat([velocity.view(-1, 2), torch.zeros_like(self.fixed)])
        d = position[first] - position[second]
        pull = self.stiffness * (1.0 - self.rest_length / torch.linalg.norm(d, dim=1))
        force = pull[:, None] * d + self.background_stiffness * (d - self.background)
        force = force + self.damping * (moving[first] - moving[second])
        total = torch.zeros_like(position)
        total = total.index_add(0, first, -force).index_add(0, second, force)
        return total[: len(velocity) // 2].flatten() / self.mass + self.gravity


def measure():
    """Return a row for each decoder."""
    torch.set_num_threads(1)
    mechanics = Mechanics(load_network('paper_2'), Gravity(9.81))
    torch.manual_seed(0)
    random = FlatModule(FlatArchitecture(400, 5)).double()
    random.configuration_mean.copy_(torch.from_numpy(mechanics.network.rest_configuration))
    checkpoint = load_checkpoint('paper_2_extended_m5')
    shipped = FlatModule(checkpoint.architecture)
    shipped.load_state_dict({k: torch.from_numpy(v) for k, v in checkpoint.tensors.items()})
    rows = []
    for name, module in (('paper', random), ('ours', shipped)):
        peer = TorchSystem(mechanics, module)
        system = CompressedSystem(mechanics, module.export(), 162)
        latent, velocity = np.random.default_rng(0).normal(size=(2, 5))
        latent_tensor, velocity_tensor = torch.from_numpy(latent), torch.from_numpy(velocity)
        np.testing.assert_allclose(
            system.acceleration(latent, velocity),
            peer.acceleration(latent_tensor, velocity_tensor),
            rtol=1e-8,
        )
        medians = side_by_side(
            lambda system=system, state=(latent, velocity): system.acceleration(*state),
            lambda peer=peer, state=(latent_tensor, velocity_tensor): peer.acceleration(*state),
            REPETITIONS,
            CALLS,
        )
        rows.append(row(f'latent_acceleration_{name}', 'torch.func', *medians))
    return rows
