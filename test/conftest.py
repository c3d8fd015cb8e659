"""Bodies and autoencoders that the tests share; numpy shapes are checked while they run."""

import base64
import configparser
import json
import os
import re
import shutil
import signal
import statistics
import struct
import subprocess
import sys
from collections import Counter
from contextlib import suppress
from dataclasses import MISSING, dataclass, fields
from functools import cache, partial, wraps
from inspect import isfunction
from itertools import groupby
from operator import itemgetter
from pathlib import Path

os.environ.setdefault('OMP_NUM_THREADS', '1')  # tests run side by side, and wait on each other

import hypothesis
import jaxtyping
import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.highlevel import AnyReader
from xdist.scheduler import LoadScopeScheduling

# Not rooms with compiled loops: numba has to see their functions as they are.
SHAPE_CHECKED = (
    'dpc_ros.network.mechanics',
    'dpc_ros.network.integration',
    'dpc_ros.network.many',
    'dpc_ros.network.body',
    'dpc_ros.autoencoder.flat',
    'dpc_ros.autoencoder.flat_module',
    'dpc_ros.autoencoder.perceptron',
    'dpc_ros.reduction.compressed_system',
    'dpc_ros.reduction.simulation',
    'dpc_ros.control',
)
CHECKED_CALLS = 10  # of each kind: those of a long simulation are thousands of one kind
_calls = Counter()


def _kind(argument):
    return (argument.shape, argument.dtype) if isinstance(argument, np.ndarray) else type(argument)


def _checked_at_first(function, typechecker, check=jaxtyping.jaxtyped):
    """Check the shapes of a function in its first calls with arguments of a kind, in each test."""
    if not isfunction(function):
        return check(function, typechecker=typechecker)
    checked = cache(lambda: check(function, typechecker=typechecker))

    @wraps(function)
    def call(*args, **kwargs):
        kinds = (function.__code__, *map(_kind, args), *map(_kind, kwargs.values()))
        _calls[kinds] += 1
        return (function if _calls[kinds] > CHECKED_CALLS else checked())(*args, **kwargs)

    return call


# What the import hook decorates every function with.
jaxtyping.jaxtyped = lambda typechecker: partial(_checked_at_first, typechecker=typechecker)
jaxtyping.install_import_hook(SHAPE_CHECKED, 'beartype.beartype')

from dpc_ros.autoencoder import load_checkpoint  # noqa: E402
from dpc_ros.bag.mcap_file import read_contents, read_messages  # noqa: E402
from dpc_ros.control.registry import ENTRY_POINT_GROUP as LAWS_GROUP  # noqa: E402
from dpc_ros.data import simulate_conditions, thin  # noqa: E402
from dpc_ros.data.conditions import training_conditions  # noqa: E402
from dpc_ros.network import (  # noqa: E402
    Gravity,
    MassSpringNetwork,
    Mechanics,
    load_network,
)
from dpc_ros.reduction import CompressedSystem  # noqa: E402
from dpc_ros.resources import share_directory  # noqa: E402
from dpc_ros.results import read_results, source_commit, write_results  # noqa: E402

# A shell ignores SIGINT for what it starts in the background, and so would the tests' processes.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

pytest_plugins = ['logs', 'this_host']  # of test/fixtures

hypothesis.settings.register_profile('dpc_ros', deadline=None, max_examples=20)
hypothesis.settings.load_profile('dpc_ros')

READER_IN_NODE = Path(__file__).parent / 'bag' / 'reader_in_node'
# As root in a container, with WebGL in software; nothing is looked up on the network.
CHROMIUM_OPTIONS = [
    '--no-sandbox',
    '--use-gl=angle',
    '--use-angle=swiftshader',
    '--enable-unsafe-swiftshader',
    '--disable-quic',
    '--disable-background-networking',
    '--disable-component-update',
    '--disable-sync',
    '--no-first-run',
]
CAMERA_DISTANCE = 1.9  # of a viewer from the body, in extents of it
CAMERA_ANGLE = np.deg2rad(75.0)  # of what it sees, from top to bottom
LONGEST_LOOK = 120.0  # s after which a test gives up on a page; it is drawn without a GPU
SPACING = 0.3  # m
ACTUATED_MASS = 162  # of the paper's bodies
_PROMISES = pytest.StashKey[dict]()
_SERIES = pytest.StashKey[dict]()  # what was measured in each repetition, by row and name


def pytest_addoption(parser):
    group = parser.getgroup('faults', 'Tests of faults')
    group.addoption('--repetitions', type=int, default=1, help='how often each fault is put in')
    help_text = 'file that takes what was measured; of tests that are not run it keeps what it has'
    group.addoption('--fault-results', type=Path, help=help_text)


def pytest_configure(config):
    config.stash[_PROMISES], config.stash[_SERIES] = {}, {}


class _ByFile(LoadScopeScheduling):
    """Keeps the tests of a file, and those on hosts of their own, in one of several workers."""

    def _split_scope(self, nodeid):
        if nodeid.startswith('test/integration/hosts/'):
            return 'hosts'
        return nodeid.partition('::')[0]


def pytest_runtest_setup():
    _calls.clear()


def pytest_xdist_make_scheduler(config, log):
    return _ByFile(config, log)


def pytest_generate_tests(metafunc):
    """Repeat a test that puts its fault in once, and says in its mark what it promises."""
    mark = metafunc.definition.get_closest_marker('faults')
    if mark is not None and mark.kwargs:
        count = min(metafunc.config.getoption('--repetitions'), mark.kwargs.get('most', 50))
        if count > 1:
            metafunc.fixturenames.append('_repetition')
            metafunc.parametrize('_repetition', range(count))


def pytest_collection_modifyitems(config, items):
    """Give a test that repeats its fault itself the time for all repetitions."""
    for item in items:
        if 'repetitions' in item.fixturenames and item.get_closest_marker('timeout') is None:
            limit = float(config.getini('timeout')) * config.getoption('--repetitions')
            item.add_marker(pytest.mark.timeout(limit))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    report = yield
    mark = item.get_closest_marker('faults')
    if mark is not None and report.when == 'call' and (mark.kwargs or report.failed):
        # One that repeats its fault itself notes the promise when it was kept in all repetitions.
        unsaid = {'fault': item.name, 'promise': '', 'mode': ''}
        row = _promise(item, **{key: mark.kwargs.get(key, unsaid[key]) for key in unsaid})
        row['repetitions'] += 1
        row['kept'] += report.passed
    return report


def pytest_sessionfinish(session, exitstatus):
    path, rows = session.config.getoption('--fault-results'), session.config.stash[_PROMISES]
    if path and exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
        run_again = {item.name for item in session.items}
        known = [
            row
            for row in (read_results(path) if path.exists() else [])
            if row['promise'] or row['fault'] not in run_again  # a test that failed
        ]
        commit = {'commit': source_commit()}
        found = {key: row | commit for key, row in rows.items()}
        write_results(path, [*({_key(row): row for row in known} | found).values()])


@pytest.fixture
def _repetition(request):
    return request.param


@pytest.fixture
def repetitions(request):
    """How often a test that repeats its fault itself is to do so."""
    return request.config.getoption('--repetitions')


@pytest.fixture
def kept_promise(request):
    """Return a function: notes a promise that held in every repetition, and what was measured.

    Of all repetitions: of times median and maximum, of whatever else the median.
    """

    def note(fault, promise, mode, repetitions, reaction=(), recovery=(), **measured):
        row = _promise(request.node, fault, promise, mode)

        def series(name, values):
            kept = request.config.stash[_SERIES].setdefault((_key(row), name), [])
            kept.extend(values)
            return kept

        for name, value in measured.items():
            row[name] = statistics.median(series(name, [value]))
        row['repetitions'] += repetitions
        row['kept'] += repetitions
        for name, seconds in (('reaction', reaction), ('recovery', recovery)):
            if seconds:
                every = series(name, seconds)
                row[f'{name}_median_ms'] = 1e3 * statistics.median(every)
                row[f'{name}_max_ms'] = 1e3 * max(every)

    return note


def _promise(item, fault, promise, mode):
    row = {'fault': fault, 'mode': mode, 'promise': promise, 'test': item.originalname}
    counts = {'repetitions': 0, 'kept': 0}
    return item.config.stash[_PROMISES].setdefault(_key(row), row | counts)


def _key(row):
    return row['fault'], row['mode'], row['test']


def make_grid(rows, columns, seed=None, name='grid'):
    """Return a hanging grid with its top row fixed; a seed draws every value at random."""
    rest = [[SPACING * j, -SPACING * i] for i in range(rows) for j in range(columns)]
    number = np.arange(rows * columns).reshape(rows, columns)
    springs = np.concatenate(
        [
            np.column_stack([first.ravel(), second.ravel()])
            for first, second in (
                (number[:, :-1], number[:, 1:]),
                (number[:-1], number[1:]),
                (number[:-1, :-1], number[1:, 1:]),
                (number[:-1, 1:], number[1:, :-1]),
            )
        ]
    )
    rest, count = np.array(rest), len(springs)
    fixed = number[0]
    draw = np.random.default_rng(seed)

    def between(low, high, size):
        return np.full(size, low) if seed is None else draw.uniform(low, high, size)

    if seed is not None:
        rest = rest + draw.uniform(-0.05, 0.05, rest.shape)
        fixed = draw.choice(len(rest), size=draw.integers(1, len(rest)), replace=False)
        springs = springs[:, ::-1] if draw.random() < 0.5 else springs
    distance = np.linalg.norm(rest[springs[:, 0]] - rest[springs[:, 1]], axis=1)
    return MassSpringNetwork(
        name=name,
        mass=between(0.05, 0.2, len(rest)),
        fixed=fixed,
        rest_position=rest,
        springs=springs,
        stiffness=between(50.0, 100.0, count),
        rest_length=distance * between(1.0, 1.2, count),
        damping=between(0.1, 0.5, count),
        background_stiffness=float(between(0.2, 2.0, ())),
        background_rest_fraction=float(between(0.5, 1.0, ())),
    )


@pytest.fixture(scope='session')
def random_network():
    """Return a function: seed → a small network with random values in every field."""
    return lambda seed: make_grid(3, 3, seed, name='random')


@pytest.fixture(scope='session')
def random_state():
    """Return a function: seed, network → (q, q̇), strained and moving."""

    def draw(seed, network):
        rng = np.random.default_rng(seed)
        strain = rng.normal(scale=0.05, size=network.configuration_size)
        return network.rest_configuration + strain, rng.normal(size=network.configuration_size)

    return draw


@pytest.fixture(scope='session')
def paper_2():
    """The paper's system 2."""
    return load_network('paper_2')


@pytest.fixture(scope='session')
def mechanics(paper_2):
    """System 2 under the gravity of the first training simulation."""
    return Mechanics(paper_2, training_conditions()[0].gravity)


@pytest.fixture(scope='session')
def paper_trajectories():
    """Return a function: network → its seven training and validation simulations, kept."""
    kept = {}

    def simulations(network):
        if network.digest not in kept:
            kept[network.digest] = list(simulate_conditions(network, training_conditions()))
        return kept[network.digest]

    return simulations


@pytest.fixture(scope='session')
def small_network():
    """A hanging grid of 15 masses, 3 of them fixed: n = 24."""
    return make_grid(5, 3)


@pytest.fixture(scope='session')
def small_mechanics(small_network):
    """The small network under gravity, askew."""
    return Mechanics(small_network, Gravity(3.0, -1.2))


@pytest.fixture(scope='session')
def small_configurations(small_network):
    """Thinned configurations of the small network, from one second under each gravity."""
    return np.concatenate(
        [
            trajectory.configuration[thin(trajectory.configuration, 0.02)]
            for _, trajectory in simulate_conditions(small_network, training_conditions(), 1.0)
        ]
    )


@pytest.fixture(scope='session')
def make_module(small_configurations):
    """Return a function: an untrained module, normalised on the small configurations."""
    import torch

    from dpc_ros.autoencoder.architecture import FlatArchitecture
    from dpc_ros.autoencoder.flat_module import FlatModule

    def make(latent_size=3, activation='silu', skip=True, seed=0):
        torch.manual_seed(seed)
        n = small_configurations.shape[1]
        module = FlatModule(FlatArchitecture(n, latent_size, (16, 8), activation, skip))
        if skip:
            module.fit_normalisation(small_configurations)
        module.normalise_latents(small_configurations)
        return module

    return make


@pytest.fixture(scope='session')
def small_autoencoder(make_module):
    """Return a function: latent size → POD bent by small random networks."""
    return cache(lambda latent_size: make_module(latent_size).export())


@pytest.fixture(scope='session')
def small_system(small_mechanics, small_autoencoder):
    """Return a function: latent size → the compressed small body, actuated at a lower corner."""
    return cache(
        lambda latent_size: CompressedSystem(
            small_mechanics, small_autoencoder(latent_size), actuated_mass=14
        )
    )


@dataclass(frozen=True)
class Shipped:
    """A shipped checkpoint with its autoencoder and compressed system."""

    checkpoint: object
    autoencoder: object
    system: CompressedSystem


@pytest.fixture(scope='session', params=['paper_2_flat_m2', 'paper_2_extended_m5'])
def shipped(request, paper_2):
    """A shipped checkpoint of the paper's recipe and one of ours, on system 2 without gravity."""
    checkpoint = load_checkpoint(request.param)
    autoencoder = checkpoint.autoencoder()
    system = CompressedSystem(Mechanics(paper_2), autoencoder, ACTUATED_MASS)
    return Shipped(checkpoint, autoencoder, system)


@pytest.fixture(scope='session')
def central_difference():
    """Return a function: derivative of f at x by all coordinates of x, second order."""

    def differentiate(function, x, step=1e-5):
        columns = []
        for direction in step * np.eye(len(x)):
            change = np.asarray(function(x + direction)) - np.asarray(function(x - direction))
            columns.append(change / (2 * step))
        return np.stack(columns, axis=-1)

    return differentiate


@pytest.fixture
def install_package(tmp_path, monkeypatch):
    """Return a function that installs a package of one module as pip would lay it down."""
    modules = []

    def install(module, code, entry_points, group='dpc_ros.autoencoders'):
        site = tmp_path / f'{module}_site'
        information = site / f'{module}-1.0.dist-info'
        information.mkdir(parents=True)
        (site / f'{module}.py').write_text(code)
        (information / 'METADATA').write_text(
            f'Metadata-Version: 2.1\nName: {module}\nVersion: 1\n'
        )
        lines = [f'{name} = {value}\n' for name, value in entry_points.items()]
        (information / 'entry_points.txt').write_text(f'[{group}]\n{"".join(lines)}')
        monkeypatch.syspath_prepend(site)
        modules.append(module)
        return site

    yield install
    for module in modules:
        sys.modules.pop(module, None)


@pytest.fixture
def spring(install_package, monkeypatch):
    """Install the law that the page on control shows, for child processes too; return its name."""
    page = (share_directory() / 'docs/control.md').read_text()
    *_, code = re.findall(r'```python\n(.*?)```', page, re.S)
    (project,) = re.findall(r'```toml\n(.*?)```', page, re.S)
    parsed = configparser.ConfigParser()  # as far as TOML goes here
    parsed.read_string(project)
    ((name, value),) = parsed['project.entry-points."dpc_ros.control_laws"'].items()
    site = install_package('my_law', code, {name: value.strip('"')}, LAWS_GROUP)
    paths = [str(site), *filter(None, [os.environ.get('PYTHONPATH')])]
    monkeypatch.setenv('PYTHONPATH', os.pathsep.join(paths))
    return name


@pytest.fixture(scope='session')
def complete_messages():
    """Return a function: MCAP file, finished or not → the messages in its complete chunks."""

    def read(file):
        messages = []
        with file.open('rb') as stream, suppress(McapError, struct.error):  # where the file ends
            for record in StreamReader(stream, validate_crcs=True).records:
                if isinstance(record, Message):
                    messages.append(record)
        return messages

    return read


@pytest.fixture
def small_disk(tmp_path):
    """A disk of 4 MiB."""
    folder = tmp_path / 'disk'
    folder.mkdir()
    command = ['mount', '-t', 'tmpfs', '-o', 'size=4m', 'small', str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f'needs the right to mount a disk: {error}')
    yield folder
    subprocess.run(['umount', '--lazy', str(folder)], check=True)


@pytest.fixture(scope='session')
def reader_in_node(request):
    """The command that prints messages as Foxglove reads them, installed; None without Node."""
    node, npm = shutil.which('node'), shutil.which('npm')
    if not node or not npm:
        return None
    folder = request.config.cache.mkdir('reader_in_node')
    lock = 'package-lock.json'
    packages = (READER_IN_NODE / lock).read_bytes()
    installed = folder / 'installed.json'
    for name in ('package.json', lock, 'read.mjs'):
        shutil.copy(READER_IN_NODE / name, folder)
    if not installed.is_file() or installed.read_bytes() != packages:
        command = [npm, 'ci', '--ignore-scripts', '--no-audit', '--no-fund']
        subprocess.run(command, cwd=folder, check=True, stdout=subprocess.DEVNULL)
        installed.write_bytes(packages)
    return [node, str(folder / 'read.mjs')]


@pytest.fixture(scope='session')
def assert_readers_agree(reader_in_node):
    """Return a function: assert that all readers find the same in each file of a bag.

    rosbags and dpc_ros read at once, Node all files in one go at the end of the session.
    """
    files = set()

    def check(bag):
        found = sorted(bag.glob('*.mcap'))
        assert found, f'{bag} holds no file'
        for file in found:
            assert_same(file, read_with_rosbags(file), read_with_dpc_ros(file))
        with AnyReader([bag]) as reader:
            whole = reader.message_count
        assert whole == sum(sum(read_contents(file).messages.values()) for file in found)
        files.update(found)

    yield check
    if reader_in_node is not None:
        silent = set(files)
        for file, rows in read_with_node(reader_in_node, sorted(files)):
            assert_same(file, read_with_rosbags(file), rows)
            silent.remove(file)
        for file in silent:
            assert_same(file, read_with_rosbags(file), [])


def read_with_rosbags(file):
    """Return topic, log time and message of everything in a file."""
    with AnyReader([file]) as reader:
        return [
            (each.topic, time, reader.deserialize(data, each.msgtype))
            for each, time, data in reader.messages()
        ]


def read_with_dpc_ros(file):
    topics = list(read_contents(file).types)
    return [(each.topic, each.log_time_ns, each.content) for each in read_messages(file, topics)]


def read_with_node(command, files):
    """Yield each file that holds messages with what Node finds in it."""
    with subprocess.Popen([*command, *map(str, files)], stdout=subprocess.PIPE) as process:
        rows = map(json.loads, process.stdout)
        for file, found in groupby(rows, key=itemgetter('file')):
            yield (
                Path(file),
                [(row['topic'], int(row['logTime']), row['message']) for row in found],
            )
    assert process.returncode == 0, 'Node can not read the files'


def assert_same(file, rows, others):
    assert len(rows) == len(others), file
    key = itemgetter(1, 0)  # the order of equal log times is the reader's choice
    for row, other in zip(sorted(rows, key=key), sorted(others, key=key), strict=True):
        assert row[:2] == other[:2], file
        assert agrees(row[2], other[2]), f'{file}: {row} and {other}'


def agrees(value, other):
    """Return whether a message of rosbags, or a part of it, is what another reader has."""
    if hasattr(value, '__msgtype__'):
        get = other.get if isinstance(other, dict) else lambda name: getattr(other, name)
        # constants have a value by default
        names = [field.name for field in fields(value) if field.default is MISSING]
        return all(agrees(getattr(value, name), get(name)) for name in names)
    if isinstance(value, np.ndarray):
        if isinstance(other, dict):
            return value.tobytes() == base64.b64decode(other['bytes'])
        read = np.frombuffer if isinstance(other, bytes) else np.array
        return value.tobytes() == read(other, dtype=value.dtype).tobytes()
    if isinstance(value, list):
        return len(value) == len(other) and all(map(agrees, value, other))
    if isinstance(other, dict):
        other = int(other['integer']) if 'integer' in other else float(other['float'])
    return value == other or (value != value and other != other)


@pytest.fixture(scope='module')
def browser():
    """Return headless Chromium, driven by Playwright."""
    from playwright.sync_api import sync_playwright

    found = filter(None, map(shutil.which, ('chromium', 'chromium-browser', 'google-chrome')))
    executable = next(found, None)
    if executable is None:
        pytest.skip('no Chromium: `make browser` installs it')
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=executable, args=CHROMIUM_OPTIONS)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser):
    """Return a call that opens an address; what the page complains of is in `page.errors`."""
    contexts = []

    def open_address(address, offline=False, **options):
        context = browser.new_context(offline=offline, **options)
        contexts.append(context)
        page = context.new_page()
        page.set_default_timeout(1e3 * LONGEST_LOOK)
        page.errors = []
        page.on('console', lambda line: line.type == 'error' and page.errors.append(line.text))
        page.on('pageerror', lambda error: page.errors.append(str(error)))
        page.goto(address)
        return page

    yield open_address
    for context in contexts:
        context.close()


@pytest.fixture
def set_field():
    """Return a call that writes into a field of a viser page, or into that beside a slider."""

    def write(page, name, value):
        label = page.get_by_text(name, exact=True)
        row = label.locator('xpath=ancestor::div[.//input or .//textarea][1]')
        field = row.locator('input, textarea').last
        field.fill(str(value))
        field.press('Enter')

    return write


@pytest.fixture
def drag():
    """Return a call that drags from one place of a body [m] to another, and does not let go."""

    def move(page, network, begin, end):
        canvas = page.locator('canvas').first.bounding_box()
        rest = network.rest_position
        low, high = rest.min(axis=0), rest.max(axis=0)
        seen = 2 * CAMERA_DISTANCE * np.tan(0.5 * CAMERA_ANGLE) * (high - low).max()
        middle = np.array([canvas['x'], canvas['y']], dtype=float)
        middle += 0.5 * np.array([canvas['width'], canvas['height']])
        pixels = np.array([1.0, -1.0]) * canvas['height'] / seen  # of a metre
        (x, y), to = (middle + pixels * (each - 0.5 * (low + high)) for each in (begin, end))
        page.mouse.move(x, y)
        page.mouse.down()
        page.mouse.move(*to, steps=2)

    return move
