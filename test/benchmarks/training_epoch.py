"""Seconds of an epoch of training, beside a loop over torch's DataLoader with the same module.

An epoch is 3370 configurations in batches of 256, as of the paper's system 2, and 1469 to validate.
Each recipe is trained for some epochs by either, one after the other, on one thread.
"""

import statistics
import time
from dataclasses import replace

import numpy as np
import torch
from side_by_side import row
from torch.utils.data import DataLoader, TensorDataset

from dpc_ros.autoencoder.modules import untrained_module
from dpc_ros.autoencoder.recipe import load_recipe
from dpc_ros.autoencoder.training import train
from dpc_ros.data import Dataset
from dpc_ros.network import load_network

TRAINED, VALIDATED = 3370, 1469
EPOCHS = {'flat': 10, 'graph': 2}
AMPLITUDE = 0.1  # m


def measure():
    """Return the rows: the flat and the graph autoencoder of the paper."""
    torch.set_num_threads(1)
    network = load_network('paper_2')
    random = np.random.default_rng(0)
    frames = network.rest_configuration + AMPLITUDE * random.standard_normal(
        (TRAINED + VALIDATED, network.configuration_size)
    )
    rows = []
    for kind, epochs in EPOCHS.items():
        recipe = replace(load_recipe(f'paper_2_{kind}_m5'), epochs=epochs)
        ours = statistics.median(_our_epochs(recipe, network, frames))
        peer = statistics.median(_plain_epochs(recipe, network, frames))
        rows.append(row(f'training_epoch_{kind}', 'a loop over torch DataLoader', ours, peer))
    return rows


def _our_epochs(recipe, network, frames):
    """Return the seconds of each epoch but the first, in which torch warms up."""
    nothing = frames[:0]
    numbers = np.zeros(0, dtype=int)
    dataset = Dataset(
        train=frames[:TRAINED],
        validation=frames[TRAINED:],
        test=nothing,
        test_velocity=nothing,
        train_simulation=np.zeros(TRAINED, dtype=int),
        validation_simulation=np.zeros(VALIDATED, dtype=int),
        test_simulation=numbers,
        provenance={},
    )
    ends = []
    train(recipe, network, dataset, on_epoch=lambda epoch, best: ends.append(time.perf_counter()))
    return np.diff(ends)


def _plain_epochs(recipe, network, frames):
    """Return the same of the loop that stands in every tutorial."""
    module = untrained_module(recipe, network)
    module.fit_normalisation(frames[:TRAINED])
    data = module.features(torch.from_numpy(frames)).float()
    batches, rest = (
        DataLoader(TensorDataset(part), recipe.batch_size, shuffle=shuffle)
        for part, shuffle in ((data[:TRAINED], True), (data[TRAINED:], False))
    )
    optimizer = torch.optim.Adam(module.parameters(), weight_decay=recipe.weight_decay)
    ends = []
    for _ in range(recipe.epochs):
        module.train()
        for (q,) in batches:
            optimizer.zero_grad()
            torch.nn.functional.mse_loss(module.reconstruct(q), q).backward()
            optimizer.step()
        module.eval()
        with torch.no_grad():
            for (q,) in rest:
                torch.nn.functional.mse_loss(module.reconstruct(q), q).item()
        ends.append(time.perf_counter())
    return np.diff(ends)
