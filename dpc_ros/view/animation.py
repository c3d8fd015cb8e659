"""The motion of a logged body as the page shows it: few frames, small numbers."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from dpc_ros.bag import Convergence, goals_in_force
from dpc_ros.network import MassSpringNetwork, picture_limits
from dpc_ros.view.colours import LARGEST_STRAIN, strain_colours
from dpc_ros.view.packing import Quantised, packed, quantise

FRAMES_PER_SECOND = 30.0  # of simulated time, at most
LARGEST_FRAMES = 6000
LARGEST_SIZE = 16_000_000  # bytes of positions, before base64 makes four of three
INTERPOLATED_GAP = 0.1  # s between two frames, up to which the page draws what lies between them
_FRAME_SIZE = 3 * 2 * 2  # bytes for each mass: body, reconstruction, target; x and y
_FARTHEST = 10.0  # lengths of the body at rest, from its middle: what is farther is not drawn
_COLOURS = 65  # of strain; odd, so that one is that of rest
_STRAIN_SHARE = 99  # % of the springs that have not the full colour yet
_STRAIN_FRAMES = 100  # that the scale of strain is found in


class NothingToShowError(ValueError):
    """A log has no motion that can be drawn, and why."""


def select_frames(
    time: Float[np.ndarray, ' samples'],
    per_second: float = FRAMES_PER_SECOND,
    largest: int = LARGEST_FRAMES,
) -> Int[np.ndarray, ' frames']:
    """Return which samples to show: the first and the last, and evenly many between.

    Args:
        time: of each sample, ascending [s].
        per_second: how many at most, but for the last.
        largest: how many at most in all, ≥ 2.
    """
    since = time - time[0]
    slots = min(since[-1] * per_second, largest - 1)
    slot = np.floor(since * (slots / since[-1])) if since[-1] > 0 else since
    _, chosen = np.unique(slot[:-1], return_index=True)
    # The last one takes the place of another where there would be too many.
    return np.append(chosen[: largest - 1], len(time) - 1)


def animate(convergence: Convergence) -> dict[str, Any]:
    """Return what the page needs to draw a logged body, ready for JSON.

    The reconstruction is D(ξ) of the logged latent states, D(E(q)) where none is logged. Frames in
    which the body is not finite, or so far away that nothing of it would be seen, are missing.

    Raises:
        NothingToShowError: the network is not known, or no configuration can be drawn.
    """
    if convergence.mechanics is None:
        identifier = convergence.run.network_identifier or 'its network'
        raise NothingToShowError(
            f'the masses and springs of {identifier} are not shipped: name the file of the network '
            'by --network'
        )
    network = convergence.mechanics.network
    run = convergence.run
    largest = LARGEST_SIZE // (_FRAME_SIZE * len(network.mass))
    chosen = select_frames(convergence.time, largest=int(np.clip(largest, 2, LARGEST_FRAMES)))
    stamps = run.configuration_stamp[chosen]
    configuration = run.configuration[chosen]
    body = _drawable(network, configuration)
    if not np.isfinite(body).any():
        raise NothingToShowError(
            'no configuration of the log is finite and near the place of the body at rest'
        )
    goal = goals_in_force(stamps, convergence.goals)
    used = np.unique(goal[goal >= 0])
    targets = _drawable(network, _rows([convergence.goals[i].configuration for i in used], network))
    seen = np.concatenate([body, targets])
    low, high = picture_limits(seen[np.isfinite(seen).all(axis=(1, 2))].reshape(-1, 2))
    reconstruction = _reconstruction(convergence, chosen)
    with np.errstate(over='ignore', invalid='ignore'):
        distance = np.sqrt(2 * np.mean((reconstruction - configuration) ** 2, axis=1))
    return {
        'time': packed(convergence.time[chosen]),
        'samples': len(convergence.time),
        'interpolated_gap': INTERPOLATED_GAP,
        'limits': [*low.tolist(), *high.tolist()],
        'springs': packed(network.springs.astype(np.uint32)),
        'rest_length': packed(network.rest_length),
        'fixed': network.fixed.tolist(),
        'largest_strain': _strain_scale(network, configuration[np.isfinite(body).all(axis=(1, 2))]),
        'colours': _strain_palette(),
        'body': _content(quantise(body)),
        'reconstruction': None
        if convergence.autoencoder is None
        else _content(quantise(_drawable(network, reconstruction))),
        'targets': _content(quantise(targets)),
        'target': packed(np.where(goal >= 0, np.searchsorted(used, goal), -1).astype(np.int32)),
        'mass': _actuated(network, run.actuated_mass),
        'force': packed(_held(run.force_stamp, run.force, stamps)),
        'nmse': packed(convergence.nmse[chosen]),
        'reconstruction_error': packed(distance),
    }


def _drawable(
    network: MassSpringNetwork, configurations: Float[np.ndarray, 'frames n']
) -> Float[np.ndarray, 'frames masses 2']:
    """Return the positions of all masses, NaN in frames that can't be drawn."""
    low, high = picture_limits(network.rest_position)
    middle, reach = (low + high) / 2, _FARTHEST * (high - low).max()
    mobile = configurations.reshape(-1, len(network.mobile), 2)
    near = (np.abs(mobile - middle) <= reach).all(axis=(1, 2))  # which NaN is not
    positions = np.full((len(configurations), len(network.mass), 2), np.nan)
    positions[near] = network.positions(configurations[near])
    return positions


def _reconstruction(
    convergence: Convergence, chosen: Int[np.ndarray, ' frames']
) -> Float[np.ndarray, 'frames n']:
    """Return D(ξ) of the latent state at each frame, NaN where there is none."""
    run, autoencoder = convergence.run, convergence.autoencoder
    configuration = run.configuration[chosen]
    if autoencoder is None:
        return np.full(configuration.shape, np.nan)
    with np.errstate(all='ignore'):  # a body that exploded leaves inf and NaN in its log
        if len(run.latent):
            latent = _held(run.latent_stamp, run.latent, run.configuration_stamp[chosen])
        else:
            known = np.isfinite(configuration).all(axis=1)
            latent = np.full((len(chosen), autoencoder.latent_size), np.nan)
            latent[known] = autoencoder.encode(configuration[known])
        known = np.isfinite(latent).all(axis=1)
        decoded = np.full(configuration.shape, np.nan)
        decoded[known] = autoencoder.decode(latent[known])
    return decoded


def _held(
    stamps: Int[np.ndarray, ' k'], values: Float[np.ndarray, 'k m'], at: Int[np.ndarray, ' frames']
) -> Float[np.ndarray, 'frames m']:
    """Return the last value at or before each stamp, NaN where there is none."""
    place = np.searchsorted(stamps, at, side='right') - 1
    known = place >= 0
    held = np.full((len(at), values.shape[1]), np.nan)
    held[known] = values[place[known]]
    return held


def _rows(
    configurations: list[Float[np.ndarray, ' n']], network: MassSpringNetwork
) -> Float[np.ndarray, 'k n']:
    return np.array(configurations).reshape(-1, network.configuration_size)


def _actuated(network: MassSpringNetwork, mass: int | None) -> int | None:
    return mass if mass is not None and mass < len(network.mass) else None


def _content(quantised: Quantised) -> dict[str, Any]:
    return {
        'low': quantised.low.tolist(),
        'step': quantised.step.tolist(),
        'level': packed(quantised.level),
    }


def _strain_scale(
    network: MassSpringNetwork, configurations: Float[np.ndarray, 'frames n']
) -> float:
    """Return a round strain that few springs exceed, at most that of markers and viewer."""
    strains = network.strains(configurations[:: 1 + len(configurations) // _STRAIN_FRAMES])
    typical = float(np.percentile(np.abs(strains), _STRAIN_SHARE)) if strains.size else 0.0
    steps = (factor * 10.0**power for power in range(-2, 0) for factor in (1, 2, 5))
    return next((step for step in steps if typical <= step), LARGEST_STRAIN)


def _strain_palette() -> list[str]:
    strains = np.linspace(-LARGEST_STRAIN, LARGEST_STRAIN, _COLOURS)
    return ['#{:02x}{:02x}{:02x}'.format(*colour) for colour in strain_colours(strains)]
