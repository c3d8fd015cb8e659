"""`dpc` as a user meets it: its help, its answers to bad input, and what it writes."""

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

import dpc_ros
from dpc_ros import cli
from dpc_ros.autoencoder import experiment
from dpc_ros.data import load_dataset
from dpc_ros.network import GeneratorSettings, generate_network, load_network, save_network

COMMANDS = [
    'generate',
    'draw',
    'simulate',
    'train',
    'select',
    'reduce',
    'reach',
    'paper',
    'top',
    'bag',
]
BAG_COMMANDS = ['info', 'repair', 'compare', 'export', 'converge', 'report', 'rerun']


@pytest.fixture
def in_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv('MPLBACKEND', 'agg')
    monkeypatch.setenv('COLUMNS', '100')


@pytest.fixture
def dpc(in_empty_folder, capfd):
    """Run `dpc` in this process, in an empty folder."""

    def run(*arguments):
        code = 0
        try:
            cli.main([*arguments])
        except SystemExit as end:
            code = end.code
        return subprocess.CompletedProcess(arguments, code, *capfd.readouterr())

    return run


@pytest.fixture
def program(in_empty_folder):
    """Run `dpc` as a process of its own, in an empty folder."""
    command = [sys.executable, '-m', 'dpc_ros.cli']
    return lambda *arguments: subprocess.run(
        [*command, *arguments], capture_output=True, text=True, check=False
    )


@pytest.mark.parametrize(
    'command',
    [[], *([name] for name in COMMANDS), *(['bag', name] for name in BAG_COMMANDS)],
    ids=' '.join,
)
def test_help_says_what_a_command_does(dpc, command):
    run = dpc(*command, '--help')
    assert run.returncode == 0
    assert run.stderr == ''
    assert run.stdout.startswith(f'usage: {" ".join(["dpc", *command])}')
    if not command:
        assert all(name in run.stdout for name in COMMANDS)
    if command == ['bag']:
        assert all(name in run.stdout for name in BAG_COMMANDS)


def test_version(program):
    assert program('--version').stdout.strip() == dpc_ros.__version__


@pytest.mark.parametrize(
    ('arguments', 'code', 'begin'),
    [
        (['--help'], 0, ''),
        (['simulate'], 2, 'usage: dpc simulate'),
        (['simulate', 'paper_9'], 2, "error: no systems file 'paper_9'"),
    ],
)
def test_process_ends_as_the_command_does(program, arguments, code, begin):
    run = program(*arguments)
    assert run.returncode == code
    assert run.stderr.startswith(begin)
    assert 'Traceback' not in run.stderr


@pytest.mark.parametrize(
    'arguments',
    [
        [],
        ['melt'],
        ['simulate'],
        ['train'],
        ['simulate', 'grid', '--colour', 'red'],
        ['generate', 'mine', '--mass', '1/0'],
        ['generate', 'mine', '--mass', 'nan'],
        ['reduce', 'paper_2'],
        ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--step', 'inf'],
    ],
)
def test_bad_usage_shows_the_usage(dpc, arguments):
    run = dpc(*arguments)
    assert run.returncode == 2
    assert run.stderr.startswith('usage: dpc')
    assert 'Traceback' not in run.stderr


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['generate', 'two words'], 'name: expected one word'),
        (['generate', 'mine', '--seed', '-1'], 'seed: expected a whole number'),
        (['generate', 'mine', '--width', '1'], 'width: expected a whole number'),
        (['generate', 'mine', '--damping', 'radial'], 'damping_kind: expected one of'),
        (['generate', 'mine', '--output', 'bad.json/mine.json'], "bad.json/mine.json can't be"),
        (['draw', 'paper_9'], 'paper_1, paper_2, paper_3, paper_4, paper_5'),
        (['draw', 'bad.json'], 'bad.json: expected a network as JSON'),
        (['simulate', 'paper_9'], 'paper_1, paper_2, paper_3, paper_4, paper_5'),
        (['simulate', 'here/nothing.json'], "'here/nothing.json'"),
        (['simulate', '~nouser/x.json'], "'~nouser/x.json'"),
        (['simulate', 'bad.json'], 'bad.json: expected a network as JSON'),
        (['simulate', 'paper_2', '--integrator', 'euler'], "unknown integrator 'euler'"),
        (['simulate', 'paper_2', '--thinning-distance', 'nan'], 'thinning distance'),
        (['simulate', 'paper_2', '--thinning-distance', '-1'], 'thinning distance'),
        (['train', '--config', 'nothing'], "'nothing'"),
        (['train', '--config', 'bad.yaml'], 'bad.yaml: expected YAML'),
        (['train', '--config', 'odd.yaml'], 'bad.yaml: expected a network as JSON'),
        (['train', '--config', 'paper_2_flat_m2', '--data', 'bad.npz'], 'bad.npz: expected a data'),
        (['select', '--config', 'nothing'], "'nothing'"),
        (['select', '--config', 'paper_2_flat_m5', '--grid', 'bad.yaml'], 'bad.yaml: expected'),
        (['select', '--config', 'paper_2_pod_m5'], "the paper has no grid for kind 'pod'"),
        (['reduce', 'paper_2', '--checkpoint', 'nothing'], "'nothing'"),
        (['reduce', 'paper_1', '--checkpoint', 'paper_2_pod_m5'], 'was trained on paper_2@'),
        (
            ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--simulation', '99'],
            'simulation 99: expected one of 1 to 37',
        ),
        (
            ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--step', '0.0123'],
            'expected a multiple of 0.005 s',
        ),
        (
            ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--encoder', 'none'],
            "encoder 'none'",
        ),
        (
            ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--method', 'euler'],
            "unknown method 'euler'",
        ),
        (
            ['reduce', 'paper_2', '--checkpoint', 'paper_2_pod_m5', '--step', '0.25'],
            'diverged with steps of 0.25 s',
        ),
        (['reach', 'paper_2', '--target', 'simulation:9@1'], 'expected one of the simulations'),
        (['reach', 'paper_2', '--target', 'rest', '--mass', '1000'], 'mass 1000'),
        (['reach', 'paper_2', '--target', 'rest', '--starts', '0'], 'starts: expected at least 2'),
        (['paper', 'nothing'], "no experiment 'nothing'"),
        (['top', '--domain', '300'], '--domain: expected 0 to 232, got 300'),
        (['bag', 'converge', 'nothing'], 'nothing'),
        (['bag', 'info', 'nothing'], 'nothing: expected the folder of a bag'),
        (['bag', 'info', 'bad.mcap'], '`dpc bag repair` saves what can be read'),
        (['bag', 'repair', 'nothing', 'new'], 'nothing: expected the folder of a bag'),
        (['bag', 'repair', 'bad.mcap', 'bad.yaml'], 'bad.yaml: expected a new place'),
        (['bag', 'repair', '.', 'new.mcap'], 'new.mcap: expected a folder'),
        (['bag', 'compare', 'nothing', 'bad.mcap'], 'nothing: expected the folder of a bag'),
        (['bag', 'export', 'bad.mcap', 'bad.npz'], 'bad.npz: expected a new place'),
        (['bag', 'export', 'bad.mcap', 'new.txt'], 'expected a name that ends in one of'),
        (['bag', 'converge', 'bad.mcap'], 'bad.mcap'),
        (['bag', 'report', 'nothing'], 'nothing: expected the folder of a bag'),
        (['bag', 'report', 'bad.mcap'], 'bad.mcap'),
        (['bag', 'rerun', 'bad.mcap', '--output', 'new'], '--output: expected --over-dds'),
    ],
    ids=lambda value: ' '.join(value) if isinstance(value, list) else '',
)
def test_bad_input_ends_with_one_line_and_leaves_nothing(dpc, tmp_path, arguments, message):
    (tmp_path / 'bad.json').write_text('{"name": ')
    (tmp_path / 'bad.yaml').write_text('name: [mine\nnetwork: x\n')
    (tmp_path / 'odd.yaml').write_text("name: odd\nnetwork: './bad.yaml'\n")
    (tmp_path / 'bad.npz').write_bytes(b'PK\x03\x04')
    (tmp_path / 'bad.mcap').write_bytes(b'\x89MCAP0\r\n')
    before = sorted(tmp_path.rglob('*'))
    run = dpc(*arguments)
    assert run.returncode == 2
    assert run.stdout == ''
    assert 'Traceback' not in run.stderr
    # A bar of progress that was begun may stand before the error.
    lines = [line for line in run.stderr.splitlines() if line]
    (error,) = [line for line in lines if not line.startswith(('simulating', 'reconstructing'))]
    assert error.startswith('error: ')
    assert message in error
    assert sorted(tmp_path.rglob('*')) == before


@pytest.mark.parametrize(
    'error', [KeyboardInterrupt(), SystemError('returned a result')], ids=['plain', 'compiled']
)
def test_ctrl_c_ends_with_130(monkeypatch, capsys, error):
    def stop(options):
        # A compiled function that is interrupted raises it so.
        raise error from KeyboardInterrupt()

    monkeypatch.setattr(cli, 'simulate', stop)
    with pytest.raises(SystemExit) as caught:
        cli.main(['simulate', 'paper_2'])
    assert caught.value.code == 130
    assert capsys.readouterr().err == 'stopped\n'


def test_other_errors_of_the_system_are_shown(monkeypatch):
    def fail(options):
        raise SystemError('a defect')

    monkeypatch.setattr(cli, 'simulate', fail)
    with pytest.raises(SystemError, match='a defect'):
        cli.main(['simulate', 'paper_2'])


@pytest.mark.parametrize('begun', [True, False])
def test_a_training_cut_off_says_that_it_can_be_taken_up(monkeypatch, capsys, tmp_path, begun):
    state = tmp_path / 'paper_2_flat_m2.state.safetensors'

    def stop(*arguments, **options):
        if begun:
            state.touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(experiment, 'train_checkpoint', stop)
    with pytest.raises(SystemExit) as caught:
        cli.main(['train', '--config', 'paper_2_flat_m2', '--output', str(tmp_path)])
    assert caught.value.code == 130
    told = f'state       {state}: the same command takes the training up again\n'
    assert capsys.readouterr().out == (told if begun else '')


def test_a_place_that_cannot_be_written_is_named(dpc, tmp_path, small_network):
    save_network(small_network, tmp_path / 'mine.json')
    run = dpc('simulate', 'mine.json', '--output', 'mine.json/data.npz')
    assert run.returncode == 2
    assert "error: mine.json/data.npz can't be written" in run.stderr
    assert 'Traceback' not in run.stderr
    assert list(tmp_path.iterdir()) == [tmp_path / 'mine.json']


def test_a_reader_that_has_seen_enough_is_no_error():
    reader, writer = os.pipe()
    os.close(reader)
    bag = Path(__file__).parent.parent / 'bags' / 'demo_1s'
    command = [sys.executable, '-m', 'dpc_ros.cli', 'bag', 'info', str(bag)]
    run = subprocess.run(command, stdout=writer, stderr=subprocess.PIPE, text=True, check=False)
    os.close(writer)
    assert (run.returncode, run.stderr) == (0, '')


def test_simulate_writes_the_data_of_a_network(dpc, tmp_path, small_network):
    save_network(small_network, tmp_path / 'mine.json')
    run = dpc('simulate', 'mine.json', '--thinning-distance', '0.3')
    assert run.returncode == 0, run.stderr
    assert small_network.identifier in run.stdout
    files = [path for path in (tmp_path / 'runs').rglob('*') if path.is_file()]
    assert files == [tmp_path / 'runs' / 'data' / 'grid.npz']
    dataset = load_dataset(files[0])
    assert dataset.provenance['network_digest'] == small_network.digest
    assert dataset.provenance['thinning_distance_m'] == 0.3
    assert len(np.unique(dataset.test_simulation)) == 28
    assert f'test        {len(dataset.test)} configurations of 28 simulations' in run.stdout


def test_simulate_writes_where_it_is_told(dpc, tmp_path, small_network):
    save_network(small_network, tmp_path / 'mine.json')
    run = dpc('simulate', 'mine.json', '--output', 'there/data.npz')
    assert run.returncode == 0, run.stderr
    written = [path.name for path in tmp_path.rglob('*') if path.is_file()]
    assert sorted(written) == ['data.npz', 'mine.json']


def test_generate_writes_the_network_of_its_seed(dpc, tmp_path):
    run = dpc('generate', 'mine', '--seed', '7')
    assert run.returncode == 0, run.stderr
    (path,) = (path for path in tmp_path.rglob('*') if path.is_file())
    assert path == tmp_path / 'runs' / 'networks' / 'mine.json'
    network = generate_network('mine', 7)
    assert load_network(path).identifier == network.identifier
    assert network.identifier in run.stdout
    assert 'masses      200 mobile, 5 fixed\nsprings     636\n' in run.stdout


def test_generate_passes_every_setting_on(dpc, tmp_path):
    settings = GeneratorSettings(
        squares=2,
        triangles=3,
        width=4,
        lateral_probability=0.9,
        lateral_decay=0.8,
        spacing=0.5,
        mass=0.1,
        stiffness=20.0,
        diagonal_stiffness=30.0,
        damping_coefficient=0.2,
        damping_kind='axial',
        background_stiffness=0.4,
        background_rest_fraction=0.25,
    )
    values = asdict(settings)
    values['damping'] = values.pop('damping_kind')
    assert values.keys() == {*cli.GENERATOR_OPTIONS, 'damping'}
    options = [f'--{key.replace("_", "-")}={value}' for key, value in values.items()]
    run = dpc('generate', 'mine', '--output', 'here.json', *options)
    assert run.returncode == 0, run.stderr
    expected = generate_network('mine', 0, settings)
    assert load_network(tmp_path / 'here.json').identifier == expected.identifier


def test_help_of_generate_names_the_defaults():
    settings = GeneratorSettings()
    for key, (kind, default, _) in cli.GENERATOR_OPTIONS.items():
        assert kind(default) == getattr(settings, key)
        assert type(kind(default)) is type(getattr(settings, key))


def test_draw_writes_a_picture(dpc, tmp_path, small_network):
    save_network(small_network, tmp_path / 'mine.json')
    for arguments, path in (
        ([], 'runs/networks/grid.png'),
        (['--output', 'here.png'], 'here.png'),
    ):
        run = dpc('draw', 'mine.json', *arguments)
        assert run.returncode == 0, run.stderr
        assert run.stdout == f'figure      {path}\n'
        assert (tmp_path / path).read_bytes().startswith(b'\x89PNG')


def test_reduce_shows_the_errors_and_writes_pictures(dpc, tmp_path):
    run = dpc(
        'reduce', 'paper_2', '--checkpoint', 'paper_2_extended_m5', '--step', '0.1',
        '--simulation', '18', '--output', 'here', '--results', 'reduced.json', '--animation',
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    names = {path.name for path in (tmp_path / 'here').iterdir()}
    assert names == {'errors.png', 'energies.png', 'frames.png', 'motion.gif'}
    *course, summary = json.loads((tmp_path / 'reduced.json').read_text())['rows']
    assert [row['time_s'] for row in course] == pytest.approx(np.arange(51) * 0.1)
    assert f'relative error of q     {summary["relative_error"]:.3%}' in run.stdout
    # Of a test simulation, and what the docs promise of its system.
    assert summary['relative_error_about_rest'] < 0.012
    assert summary['energy_increase'] < 1e-6


def test_reach_shows_the_static_bound_and_draws_it(dpc, tmp_path):
    run = dpc(
        'reach', 'paper_2', '--target', 'simulation:4@100', '--starts', '2', '--figure', 'a.png'
    )  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert 'static nMSE' in run.stdout
    nmse = float(run.stdout.split('static nMSE')[1].split()[0])
    assert 0 < nmse < 1
    assert (tmp_path / 'a.png').read_bytes().startswith(b'\x89PNG')
