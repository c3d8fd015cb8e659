"""Numbers that the paper prints, and those of the authors' released models, to stand beside ours.

All are mean square errors [m²] over coordinates and frames.
"""

from __future__ import annotations

# Table of section IV: training, validation and test error at m = 5.
MSE: dict[tuple[str, str], tuple[float, float, float]] = {
    ('paper_1', 'flat'): (2.17e-4, 4.73e-4, 4.24e-4),
    ('paper_1', 'graph'): (3.40e-4, 5.24e-4, 7.25e-4),
    ('paper_2', 'flat'): (1.13e-4, 2.48e-4, 3.08e-4),
    ('paper_2', 'graph'): (12.24e-4, 15.37e-4, 17.94e-4),
    ('paper_3', 'flat'): (1.69e-4, 4.41e-4, 3.75e-4),
    ('paper_3', 'graph'): (3.73e-4, 8.13e-4, 7.37e-4),
    ('paper_4', 'flat'): (4.75e-4, 18.08e-4, 12.51e-4),
    ('paper_4', 'graph'): (5.56e-4, 13.72e-4, 9.71e-4),
    ('paper_5', 'flat'): (8.53e-4, 11.7e-4, 12.70e-4),
    ('paper_5', 'graph'): (7.41e-4, 9.48e-4, 9.59e-4),
}

# Test error by latent size: the flat autoencoder's figure, the graph autoencoder's release.
COMPRESSION: dict[tuple[str, str], dict[int, float]] = {
    ('paper_1', 'flat'): {2: 1.84e-2, 3: 4.62e-4, 4: 5.04e-4},
    ('paper_2', 'flat'): {2: 9.35e-3, 3: 3.08e-4, 4: 3.20e-4},
    ('paper_3', 'flat'): {2: 1.11e-2, 3: 4.08e-4, 4: 4.88e-4},
    ('paper_4', 'flat'): {2: 1.71e-2, 3: 1.32e-3, 4: 1.18e-3},
    ('paper_5', 'flat'): {2: 8.40e-3, 3: 1.28e-3, 4: 1.23e-3},
    ('paper_1', 'graph'): {2: 1.82e-2, 3: 9.5e-4, 4: 6.7e-4},
    ('paper_2', 'graph'): {2: 9.6e-3, 3: 9.3e-4, 4: 5.9e-4},
    ('paper_3', 'graph'): {2: 1.2e-2, 3: 7.0e-4, 4: 6.6e-4},
    ('paper_4', 'graph'): {2: 2.8e-2, 3: 2.2e-3, 4: 1.5e-3},
    ('paper_5', 'graph'): {2: 9.5e-3, 3: 1.2e-3, 4: 8.1e-4},
}

NOISE_DEVIATIONS = (0.01, 0.05, 0.1, 0.5, 1.0, 5.0)  # m

# Table of section A.3, by the deviations above.
NOISE: dict[tuple[str, str], tuple[float, ...]] = {
    ('paper_1', 'flat'): (3.00e-4, 3.52e-4, 5.06e-4, 5.57e-3, 2.07e-2, 4.12e-1),
    ('paper_1', 'graph'): (3.95e-4, 5.11e-4, 8.94e-4, 1.40e-2, 6.62e-2, 1.03),
    ('paper_2', 'flat'): (1.57e-4, 1.90e-4, 2.97e-4, 3.73e-3, 1.40e-2, 2.60e-1),
    ('paper_2', 'graph'): (1.33e-4, 1.39e-4, 1.58e-4, 7.89e-3, 2.94e-2, 1.01),
    ('paper_3', 'flat'): (2.58e-4, 2.92e-4, 3.99e-4, 3.91e-3, 1.46e-2, 2.72e-1),
    ('paper_3', 'graph'): (5.24e-4, 5.95e-4, 8.09e-4, 7.75e-3, 3.12e-2, 1.16),
    ('paper_4', 'flat'): (8.90e-4, 9.22e-4, 1.02e-3, 4.10e-3, 1.36e-2, 2.61e-1),
    ('paper_4', 'graph'): (8.34e-4, 9.32e-4, 1.25e-3, 1.16e-2, 4.53e-2, 9.46e-1),
    ('paper_5', 'flat'): (9.54e-4, 9.89e-4, 1.10e-3, 4.67e-3, 1.52e-2, 2.86e-1),
    ('paper_5', 'graph'): (8.13e-4, 8.47e-4, 9.53e-4, 4.69e-3, 1.88e-2, 6.84e-1),
}


def published_mse(system: str, model: str, latent_size: int) -> float | None:
    """Return the published test error of a flat or graph autoencoder [m²], if there is one."""
    return published_mse_by_size(system, model).get(latent_size)


def published_mse_by_size(system: str, model: str) -> dict[int, float]:
    """Return every published test error of a model on a system [m²], by latent size."""
    values = dict(COMPRESSION.get((system, model), {}))
    if (system, model) in MSE:
        values[5] = MSE[system, model][2]
    return values


def best_test_mse(system: str, latent_size: int) -> float | None:
    """Return the better of the published test errors at a latent size [m²], none if none is."""
    published = [published_mse(system, model, latent_size) for model in ('flat', 'graph')]
    return min((value for value in published if value is not None), default=None)
