"""Derivatives of a dense autoencoder and the latent right-hand side ξ̈, beside torch's autograd.

The peers are what a user writes with torch.func in double precision: encoder and ξ̇ by a jvp,
decoder and Jacobian by forward mode, J̇ξ̇ as a jvp of a jvp, or by a product with the Hessian of
each output, the body's forces by torch, a solve. Autoencoders: the paper's sizes 400-300-200-100-5
with random weights, and the shipped one of ours.
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
GOAL, GOAL_PER_OUTPUT = 10.0, 100.0  # times as fast


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

    def encode(self, configuration):
        return self.module.encode(configuration[None])[0]

    def decode(self, latent):
        return self.module.decode(latent[None])[0]

    def encode_with_velocity(self, configuration, velocity):
        return torch.func.jvp(self.encode, (configuration,), (velocity,))

    def decode_with_jacobian(self, latent):
        def twice(xi):
            decoded = self.decode(xi)
            return decoded, decoded

        jacobian, decoded = torch.func.jacfwd(twice, has_aux=True)(latent)
        return decoded, jacobian

    def bend(self, latent, velocity):
        """Return J̇ξ̇ as the second derivative along ξ̇."""
        return torch.func.jvp(
            lambda xi: torch.func.jvp(self.decode, (xi,), (velocity,))[1], (latent,), (velocity,)
        )[1]

    def bend_by_output(self, latent, velocity):
        """Return J̇ξ̇ as ξ̇ᵀH_iξ̇ with the Hessian H_i of one output after the other."""

        def product(output):
            gradient = torch.func.grad(lambda xi: self.decode(xi)[output])
            return velocity @ torch.func.jvp(gradient, (latent,), (velocity,))[1]

        return torch.stack([product(output) for output in range(len(self.mass))])

    def acceleration(self, latent, velocity, bend=None):
        decoded, jacobian = self.decode_with_jacobian(latent)
        moved = (bend or self.bend)(latent, velocity)
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
    """Return the rows of each autoencoder."""
    torch.set_num_threads(1)
    mechanics = Mechanics(load_network('paper_2'), Gravity(9.81))
    torch.manual_seed(0)
    random = FlatModule(FlatArchitecture(400, 5)).double()
    random.configuration_mean.copy_(torch.from_numpy(mechanics.network.rest_configuration))
    checkpoint = load_checkpoint('paper_2_extended_m5')
    shipped = FlatModule(checkpoint.architecture)
    shipped.load_state_dict({k: torch.from_numpy(v) for k, v in checkpoint.tensors.items()})
    return [*_rows('paper', mechanics, random), *_rows('ours', mechanics, shipped)]


def _rows(name, mechanics, module):
    peer = TorchSystem(mechanics, module)
    autoencoder = module.export()
    system = CompressedSystem(mechanics, autoencoder, 162)
    rng = np.random.default_rng(0)
    latent = rng.normal(size=(2, 5))
    full = mechanics.network.rest_configuration, rng.normal(size=400)
    latent_there, full_there = (
        [torch.from_numpy(each) for each in pair] for pair in (latent, full)
    )
    ways = {
        'encode_with_velocity': (
            lambda: autoencoder.encoder_jacobian_vector_product(*full),
            {'torch.func.jvp': lambda: peer.encode_with_velocity(*full_there)},
        ),
        'decode_with_jacobian': (
            lambda: autoencoder.decode_with_jacobian(latent[0]),
            {'torch.func.jacfwd': lambda: peer.decode_with_jacobian(latent_there[0])},
        ),
        'latent_acceleration': (
            lambda: system.acceleration(*latent),
            {
                'torch.func': lambda: peer.acceleration(*latent_there),
                'a Hessian product per output': lambda: peer.acceleration(
                    *latent_there, peer.bend_by_output
                ),
            },
        ),
    }
    rows = []
    for what, (ours, peers) in ways.items():
        for their_name, theirs in peers.items():
            slow = 'per output' in their_name
            for found, expected in zip(_arrays(ours()), _arrays(theirs()), strict=True):
                np.testing.assert_allclose(found, expected, rtol=1e-8, atol=1e-10)
            medians = side_by_side(ours, theirs, *((3, 1) if slow else (REPETITIONS, CALLS)))
            goal = GOAL_PER_OUTPUT if slow else GOAL
            rows.append(row(f'{what}_{name}', their_name, *medians, goal=goal))
    return rows


def _arrays(result):
    return result if isinstance(result, tuple) else (result,)
