"""Checkpoints come back bit for bit, and no damaged or foreign file is taken for one."""

import hashlib
import json
import pickle
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load, save

from dpc_ros.autoencoder import Checkpoint, CheckpointError, load_checkpoint, save_checkpoint
from dpc_ros.autoencoder.training import reconstruction_mse
from dpc_ros.data import extra_conditions, simulate_conditions, thin
from dpc_ros.data.conditions import training_conditions
from dpc_ros.network import load_network


@pytest.fixture
def checkpoint(make_module, small_network):
    module = make_module(3)
    return Checkpoint(
        name='grid_skip_m3',
        architecture=module.architecture,
        tensors=module.tensors(),
        network={'name': small_network.name, 'digest': small_network.digest},
        provenance={'recipe': {'seed': 3}, 'scores': {'test_mse': 0.1}},
    )


@pytest.fixture
def path(checkpoint, tmp_path):
    return save_checkpoint(checkpoint, tmp_path / 'checkpoints')


@pytest.fixture(scope='module')
def validation_frames():
    """Return a function: the validation data of system 2 with so many extra simulations."""

    @cache
    def frames(extra_simulations):
        extra = extra_conditions(extra_simulations)
        # From the last start at rest on: what is before it does not reach the validation data.
        first = sum(condition.split == 'train' for condition in extra)
        while extra and extra[first].start != 'rest':
            first -= 1
        kept = []
        for conditions, distance in ((training_conditions(), 0.1), (extra[first:], 3 * 0.1)):
            for condition, trajectory in simulate_conditions(load_network('paper_2'), conditions):
                if condition.split == 'validation':
                    frames = trajectory.configuration
                    kept.append(frames[thin(frames, distance)])
        return np.concatenate(kept)

    return frames


def rewrite(path, **changes):
    """Change keys of the JSON; one that is None goes."""
    content = {**json.loads(path.read_text()), **changes}
    path.write_text(json.dumps({key: v for key, v in content.items() if v is not None}))


def rewrite_tensors(path, change):
    """Change the tensors and note the right check sum of the changed file."""
    tensors_path = path.with_suffix('.safetensors')
    tensors = load(tensors_path.read_bytes())
    change(tensors)
    data = save(tensors)
    tensors_path.write_bytes(data)
    rewrite(path, sha256=hashlib.sha256(data).hexdigest())


def test_round_trip_keeps_every_bit(checkpoint, path):
    loaded = load_checkpoint(path)
    assert loaded.tensors.keys() == checkpoint.tensors.keys()
    for name, value in checkpoint.tensors.items():
        assert loaded.tensors[name].dtype == value.dtype
        assert loaded.tensors[name].shape == value.shape
        assert loaded.tensors[name].tobytes() == value.tobytes()
    assert (loaded.name, loaded.architecture) == (checkpoint.name, checkpoint.architecture)
    assert (loaded.network, loaded.provenance) == (checkpoint.network, checkpoint.provenance)
    assert sorted(file.name for file in path.parent.iterdir()) == [
        'grid_skip_m3.json',
        'grid_skip_m3.safetensors',
    ]


def test_the_loaded_autoencoder_is_the_saved_one(checkpoint, path, small_configurations):
    before, after = checkpoint.autoencoder(), load_checkpoint(path).autoencoder()
    latent = before.encode(small_configurations)
    np.testing.assert_array_equal(after.encode(small_configurations), latent)
    np.testing.assert_array_equal(after.decode(latent), before.decode(latent))


def test_digest_follows_the_tensors(checkpoint, path, tmp_path):
    first = load_checkpoint(path)
    assert len(first.digest) == 12
    assert first.identifier == f'grid_skip_m3@{first.digest}'
    again = load_checkpoint(save_checkpoint(replace(checkpoint, name='again'), tmp_path))
    assert again.digest == first.digest
    rewrite_tensors(path, lambda tensors: tensors['latent_mean'].__iadd__(1.0))
    assert load_checkpoint(path).digest != first.digest


def test_belongs_to_its_network(checkpoint, small_network, paper_2):
    checkpoint.check_network(small_network)
    with pytest.raises(CheckpointError, match=rf'grid@.*, not on {paper_2.identifier}'):
        checkpoint.check_network(paper_2)


@pytest.mark.parametrize('fraction', [0.0, 0.5, 0.999])
def test_truncated_tensors_are_refused(path, fraction):
    tensors = path.with_suffix('.safetensors')
    content = tensors.read_bytes()
    tensors.write_bytes(content[: int(fraction * len(content))])
    with pytest.raises(CheckpointError, match=r'\.safetensors: truncated or altered'):
        load_checkpoint(path)


def test_one_altered_bit_is_noticed(path):
    tensors = path.with_suffix('.safetensors')
    content = bytearray(tensors.read_bytes())
    content[-5] ^= 1
    tensors.write_bytes(content)
    with pytest.raises(CheckpointError, match='truncated or altered, expected SHA-256'):
        load_checkpoint(path)


def test_missing_tensors_are_named(path):
    path.with_suffix('.safetensors').unlink()
    with pytest.raises(CheckpointError, match=r'grid_skip_m3\.safetensors are missing'):
        load_checkpoint(path)


@pytest.mark.parametrize(
    'text', ['', '{"format": "dpc_ros.check', '[]', '{}', 'format: x', '[' * 100_000]
)
def test_json_that_is_no_checkpoint_is_refused(path, text):
    path.write_text(text)
    with pytest.raises(CheckpointError, match=r'grid_skip_m3\.json: expected a checkpoint'):
        load_checkpoint(path)


@pytest.mark.parametrize(
    ('changes', 'message'),
    [
        ({'format': 'other'}, 'expected a checkpoint, "format" should be \'dpc_ros.checkpoint\''),
        ({'version': 2}, 'version 2; this dpc_ros reads version 1'),
        ({'version': None}, 'version None; this dpc_ros reads version 1'),
        ({'kind': 'wavelet'}, r"kind 'wavelet': expected one of \['flat', 'graph', 'pod'"),
        ({'kind': None}, "kind '': expected one of"),
        ({'kind': ['flat']}, r"kind \['flat'\]: expected one of"),
        ({'kind': 'graph'}, 'architecture and tensors do not fit'),
        ({'kind': 'pod'}, 'architecture and tensors do not fit'),
        ({'sha256': None}, r"expected the keys \['sha256'\]"),
        ({'network': None}, r"expected the keys \['network'\]"),
        ({'network': 'paper_2'}, 'network'),
        ({'network': {'name': 'grid'}}, 'network'),
        ({'architecture': [24, 3]}, 'architecture'),
        ({'architecture': {'configuration_size': 24}}, 'latent_size'),
        ({'architecture': {'configuration_size': 24, 'latent_size': 3, 'depth': 3}}, 'depth'),
        ({'architecture': {'configuration_size': 400, 'latent_size': 3}}, 'expected shape'),
        ({'name': 7}, 'name: expected a text, got 7'),
        ({'name': ['grid']}, 'name: expected a text'),
    ],
)
def test_json_that_does_not_fit_is_refused(path, changes, message):
    rewrite(path, **changes)
    with pytest.raises(CheckpointError, match=message):
        load_checkpoint(path)


@pytest.mark.parametrize('skip', [True, False])
def test_an_altered_skip_is_refused(make_module, small_network, tmp_path, skip):
    module = make_module(3, skip=skip)
    network = {'name': small_network.name, 'digest': small_network.digest}
    checkpoint = Checkpoint('grid', module.architecture, module.tensors(), network)
    path = save_checkpoint(checkpoint, tmp_path)
    architecture = json.loads(path.read_text())['architecture']
    for value, message in (
        (not skip, 'pod_basis: expected shape'),
        (int(skip), 'skip: expected true or false'),
        (str(skip), 'skip: expected true or false'),
        (None, 'skip: expected true or false'),
    ):
        rewrite(path, architecture={**architecture, 'skip': value})
        with pytest.raises(CheckpointError, match=message):
            load_checkpoint(path)


def test_unknown_tensors_are_refused(path):
    for name in ('encoder.6.weight', 'encoder.1.weight', 'extra'):
        tensors = path.with_suffix('.safetensors').read_bytes()
        rewrite_tensors(path, lambda tensors, name=name: tensors.update({name: np.ones(2)}))
        with pytest.raises(CheckpointError, match=rf"expected no tensors \['{name}'\]"):
            load_checkpoint(path)
        path.with_suffix('.safetensors').write_bytes(tensors)


@pytest.mark.parametrize('value', [np.nan, np.inf])
@pytest.mark.parametrize('name', ['encoder.0.weight', 'decoder.4.bias', 'latent_scale'])
def test_values_that_are_not_finite_are_refused(path, name, value):
    rewrite_tensors(path, lambda tensors: tensors[name].fill(value))
    with pytest.raises(CheckpointError, match=r'\.safetensors: holds values that are not finite'):
        load_checkpoint(path)


@pytest.mark.parametrize('name', ['latent_scale', 'configuration_scale', 'pod_scale'])
def test_scales_have_to_be_positive(path, name):
    rewrite_tensors(path, lambda tensors: tensors[name].fill(0))
    with pytest.raises(CheckpointError, match=f'{name}: expected'):
        load_checkpoint(path)


@pytest.mark.parametrize('name', ['encoder.0.weight', 'configuration_scale', 'pod_basis'])
def test_missing_and_misshapen_tensors_are_named(path, name):
    rewrite_tensors(path, lambda tensors: tensors.update({name: np.ones((2, 7))}))
    with pytest.raises(CheckpointError, match=f'{name}: expected'):
        load_checkpoint(path)
    rewrite_tensors(path, lambda tensors: tensors.pop(name))
    with pytest.raises(CheckpointError, match=f'{name}.* is missing'):
        load_checkpoint(path)


class Trap:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, mark):
        self.mark = mark

    def __reduce__(self):
        return Path.touch, (self.mark,)


@pytest.mark.parametrize('protocol', [0, pickle.HIGHEST_PROTOCOL])
def test_pickles_are_never_opened(path, tmp_path, protocol):
    mark = tmp_path / 'unpickled'
    data = pickle.dumps(Trap(mark), protocol)
    tensors = path.with_suffix('.safetensors')
    tensors.write_bytes(data)
    rewrite(path, sha256=hashlib.sha256(data).hexdigest())
    with pytest.raises(CheckpointError):
        load_checkpoint(path)
    path.write_bytes(data)
    with pytest.raises(CheckpointError, match='expected a checkpoint as JSON'):
        load_checkpoint(path)
    assert not mark.exists()


def test_a_missing_checkpoint_names_the_shipped_ones(tmp_path):
    for name in ('paper_9', tmp_path / 'nothing.json'):
        with pytest.raises(FileNotFoundError, match=r'shipped names .*paper_2_flat_m2'):
            load_checkpoint(name)


def test_shipped_checkpoints_belong_to_system_2(shipped, paper_2):
    shipped.checkpoint.check_network(paper_2)
    assert shipped.autoencoder.configuration_size == paper_2.configuration_size
    assert shipped.checkpoint.name.endswith(f'm{shipped.autoencoder.latent_size}')


@pytest.mark.parametrize('name', ['flat_m2', 'pod_m5', 'extended_m2', 'extended_m3', 'extended_m5'])
def test_shipped_checkpoints_have_the_error_that_they_state(name, validation_frames):
    checkpoint = load_checkpoint(f'paper_2_{name}')
    provenance = checkpoint.provenance
    frames = validation_frames(provenance['recipe'].get('extra_simulations', 0))
    error = reconstruction_mse(checkpoint.autoencoder(), frames)
    assert error == pytest.approx(provenance['scores']['validation_mse'], rel=1e-6)
