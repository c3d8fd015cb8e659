"""Whatever has become of a file: it is read, or refused with a reason; nothing else is raised."""

import hashlib
import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.autoencoder import Checkpoint, load_checkpoint, save_checkpoint
from dpc_ros.autoencoder.recipe import load_recipe
from dpc_ros.bag import read_contents, read_run
from dpc_ros.control import load_target
from dpc_ros.network import load_network, save_network
from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.parameters import read_options
from dpc_ros.resources import config_path, share_directory

SAMPLE = share_directory() / 'bags' / 'demo_1s'
# A log is large: what is changed lies in its first or its last bytes, where its structure is.
STRUCTURE = 20_000

_leaves = (
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([0, -1, 2**63, 10**400, float('nan'), float('inf'), 1e308])
    | st.floats()
    | st.text(max_size=5)
)
values = st.recursive(
    _leaves,
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=3), inner, max_size=3)
    ),
    max_leaves=5,
)
damages = st.lists(
    st.tuples(st.floats(0, 1), st.integers(0, 40), st.binary(max_size=12)), min_size=1, max_size=4
)


def damaged(content, damages):
    """Return bytes with pieces put in place of others, each at a fraction of the length."""
    for place, length, piece in damages:
        at = int(place * len(content))
        content = content[:at] + piece + content[at + length :]
    return content


@st.composite
def altered(draw, content):
    """Return JSON content with any one of its values, at any depth, replaced or left out."""
    content = json.loads(json.dumps(content))
    inner = content
    while True:
        keys = sorted(inner) if isinstance(inner, dict) else range(len(inner))
        key = draw(st.sampled_from(keys))
        if isinstance(inner[key], dict | list) and inner[key] and draw(st.booleans()):
            inner = inner[key]
            continue
        if draw(st.integers(0, 5)):
            inner[key] = draw(values)
        else:
            del inner[key]
        return content


def read_or_refuse(read, *arguments):
    """Return what is read, none where it is refused; `FileNotFoundError` is a refusal, too."""
    try:
        return read(*arguments)
    except (ValueError, OSError):
        return None


@pytest.fixture(scope='module')
def files(tmp_path_factory, small_network, make_module):
    """One small file of each kind, which can be read."""
    folder = tmp_path_factory.mktemp('files')
    module = make_module(3)
    checkpoint = Checkpoint(
        name='grid_m3',
        architecture=module.architecture,
        tensors=module.tensors(),
        network={'name': small_network.name, 'digest': small_network.digest},
    )
    network = folder / 'network.json'
    save_network(small_network, network)
    target = folder / 'target.json'
    target.write_text(json.dumps({'latent': [0.0, 1.0, 2.0]}))
    return {
        'network': network,
        'checkpoint': save_checkpoint(checkpoint, folder),
        'target': target,
        'recipe': Path(next(iter(sorted(config_path('training').glob('*.yaml'))))),
        'parameters': config_path('demo.yaml'),
    }


@pytest.fixture(scope='module')
def readers(small_network, tmp_path_factory):
    run = tmp_path_factory.mktemp('runs') / 'new'
    return {
        'network': load_network,
        'checkpoint': load_checkpoint,
        'target': lambda path: load_target(str(path), small_network),
        'recipe': load_recipe,
        'parameters': lambda path: make_plan(path, {}, run),
    }


KINDS = ['network', 'checkpoint', 'target', 'recipe', 'parameters']


@pytest.mark.parametrize('kind', KINDS)
def test_the_file_itself_is_read(kind, files, readers):
    assert readers[kind](files[kind]) is not None


@pytest.mark.parametrize('kind', KINDS)
@settings(max_examples=60)
@given(data=st.data())
def test_damaged_bytes(kind, data, files, readers, tmp_path_factory):
    path = files[kind].with_name(f'damaged{files[kind].suffix}')
    if kind in ('recipe', 'parameters'):
        path = tmp_path_factory.mktemp('damaged') / 'damaged.yaml'
    path.write_bytes(damaged(files[kind].read_bytes(), data.draw(damages)))
    read_or_refuse(readers[kind], path)


@pytest.mark.parametrize('kind', ['network', 'checkpoint', 'target'])
@settings(max_examples=150)
@given(data=st.data())
def test_altered_values(kind, data, files, readers):
    content = json.loads(files[kind].read_text())
    path = files[kind].with_name(f'{files[kind].stem}_altered.json')
    path.write_text(json.dumps(data.draw(altered(content))))
    tensors = files[kind].with_suffix('.safetensors')
    if tensors.exists():
        path.with_suffix('.safetensors').write_bytes(tensors.read_bytes())
    read_or_refuse(readers[kind], path)


@settings(max_examples=150)
@given(damages=damages)
def test_damaged_tensors(damages, files):
    """Whose digest is right: somebody has written them so."""
    path = files['checkpoint'].with_name('tensors.json')
    content = damaged(files['checkpoint'].with_suffix('.safetensors').read_bytes(), damages)
    path.with_suffix('.safetensors').write_bytes(content)
    header = json.loads(files['checkpoint'].read_text())
    header['sha256'] = hashlib.sha256(content).hexdigest()
    path.write_text(json.dumps(header))
    checkpoint = read_or_refuse(load_checkpoint, path)
    if checkpoint is not None:
        assert all(np.isfinite(value).all() for value in checkpoint.tensors.values())


@settings(max_examples=60)
@given(text=st.text(max_size=40) | values.map(repr))
def test_options_of_a_law(text):
    options = read_or_refuse(read_options, text, 'law_options')
    assert options is None or isinstance(options, dict)


@pytest.mark.parametrize('end', ['first', 'last'])
@settings(max_examples=40)
@given(damages=damages)
def test_damaged_logs(end, damages, tmp_path_factory):
    folder = tmp_path_factory.mktemp('log')
    content = (SAMPLE / 'bag_0.mcap').read_bytes()
    if end == 'first':
        content = damaged(content[:STRUCTURE], damages) + content[STRUCTURE:]
    else:
        content = content[:-STRUCTURE] + damaged(content[-STRUCTURE:], damages)
    file = folder / 'bag_0.mcap'
    file.write_bytes(content)
    read_or_refuse(read_contents, file)
    read_or_refuse(read_run, file)


@settings(max_examples=40)
@given(damages=damages)
def test_a_damaged_description_of_a_log(damages, tmp_path_factory):
    folder = tmp_path_factory.mktemp('bag')
    (folder / 'bag_0.mcap').symlink_to((SAMPLE / 'bag_0.mcap').resolve())
    content = (SAMPLE / 'metadata.yaml').read_bytes()
    (folder / 'metadata.yaml').write_bytes(damaged(content, damages))
    read_or_refuse(read_contents, folder)
