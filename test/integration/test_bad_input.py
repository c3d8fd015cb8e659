"""Each bad input gets one clear line, an exit code, and leaves nothing half-written."""

import json
from importlib import import_module

import pytest

from dpc_ros.resources import config_path


def ros_arguments(*parameters):
    return ['--ros-args', *(part for item in parameters for part in ('-p', item))]


@pytest.fixture
def run_here(domain, monkeypatch, capfd):
    """Return a function: runs a program in this process; processes of their own are below."""
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain.number))

    def run(module, *arguments):
        code = 0
        try:
            import_module(f'dpc_ros.nodes.{module}').main([*arguments])
        except SystemExit as end:
            code = end.code
        return code, ''.join(capfd.readouterr())

    return run


def assert_one_clear_error(output, *words):
    errors = [line for line in output.splitlines() if line.startswith('error:')]
    assert len(errors) == 1, output
    assert 'Traceback' not in output
    for word in words:
        assert word in errors[0], errors[0]


@pytest.mark.parametrize(
    ('kind', 'parameter', 'words'),
    [
        ('simulator', 'rat:=100.0', ("unknown parameter 'rat'", 'rate')),
        ('simulator', 'rate:=-1.0', ('rate', 'expected 1 to 2000 Hz', '-1')),
        ('simulator', 'rate:=fast', ('rate', 'expected a double', "'fast'")),
        ('simulator', 'time_mode:=soon', ('time_mode', 'lockstep, realtime', 'soon')),
        ('recorder', 'attach:=[sound]', ('attach', 'network, checkpoint')),
        ('viewer', 'port:=70000', ('port', 'expected 0 to 65535', '70000')),
    ],
)
def test_bad_parameters(run_here, kind, parameter, words):
    code, output = run_here(f'{kind}_node', *ros_arguments(parameter))
    assert code == 2
    assert_one_clear_error(output, *words)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['rate:=5.0'], ('unknown arguments', 'rate:=5.0', '--ros-args')),
        (['--help'], ('unknown arguments', '--help', 'config/nodes')),
        (['--ros-args', '--bogus'], ('ROS arguments', 'bogus')),
        (['--ros-args', '--params-file', 'nowhere.yaml'], ('ROS arguments', 'nowhere.yaml')),
    ],
)
def test_arguments_that_are_no_ros_arguments(run_here, arguments, words):
    code, output = run_here('simulator_node', *arguments)
    assert code == 2
    assert_one_clear_error(output, *words)


@pytest.mark.parametrize(
    ('kind', 'parameters', 'words'),
    [
        ('simulator', ['network:=nowhere'], ('nowhere', 'paper_1')),
        ('controller', ['law:=magic'], ("'magic'", 'lqr, reduced_equilibrium, transpose, paper')),
        ('controller', ["law_options:='[1, 2'"], ('law_options', 'YAML')),
        ('controller', ["law_options:='[1, 2]'"], ('law_options', 'names and values')),
        ('simulator', ['actuated_mass:=3'], ('mass 3', 'fixed')),
        ('simulator', ['actuated_mass:=205'], ('no mass 205', '0 to 204')),
        ('encoder', ['network:=paper_1'], ('paper_2_extended_m5', 'trained on paper_2', 'paper_1')),
        ('encoder', ['checkpoint:=nothing'], ('nothing', 'paper_2_extended_m5')),
        ('encoder', ['measure_delay:=true'], ('measure_delay', 'observer kalman')),
        (
            'encoder',
            ['observer:=kalman', 'measure_delay:=true', 'delay:=0.01'],
            ('measure_delay', 'delay 0', 'not both'),
        ),
        ('markers', ['network:=paper_1'], ('paper_2_extended_m5', 'trained on paper_2')),
        ('markers', ["frame:=''"], ("'world'",)),
        ('controller', ['actuated_mass:=3'], ('mass 3', 'fixed')),
        ('controller', ['target:=simulation:9@1'], ('simulation:9@1', '[1, 2, 3, 4, 5, 6, 7]')),
        ('controller', ['target:=simulation:1@5000'], ('5000', '0 to 1000')),
        ('recorder', [f'bag:={config_path()}'], ('expected a new or an empty folder',)),
        ('recorder', ["topics:=['the body']"], ('topics', 'names of topics', "'the body'")),
        ('recorder', ["exclude:=['/a//b']"], ('exclude', 'patterns', "'/a//b'")),
        ('recorder', [f'parameters_file:={__file__}'], (__file__, 'ROS 2 parameter file')),
        ('recorder', ['parameters_file:=/nowhere.yaml'], ('/nowhere.yaml',)),
    ],
)
def test_what_can_not_be_configured(run_here, tmp_path, monkeypatch, kind, parameters, words):
    monkeypatch.chdir(tmp_path)
    code, output = run_here(f'{kind}_node', *ros_arguments(*parameters))
    assert code == 1
    assert_one_clear_error(output, *words)
    assert not any(path.suffix == '.mcap' for path in tmp_path.rglob('*'))


@pytest.mark.parametrize(
    ('content', 'words'),
    [
        ({'configuration': [0.0] * 399}, ('400', '399')),
        ({'configuration': [float('nan')] * 400}, ('finite', 'nan')),
        ({'latent': [0.0] * 4}, ('5', '4')),
        ({'both': 1}, ('"configuration" or "latent"',)),
    ],
)
def test_bad_target_files(run_here, tmp_path, content, words):
    path = tmp_path / 'target.json'
    path.write_text(json.dumps(content))
    code, output = run_here('controller_node', *ros_arguments(f'target:={path}'))
    assert code == 1
    assert_one_clear_error(output, *words)


@pytest.mark.parametrize(
    ('arguments', 'words'),
    [
        (['--set', 'simulator.rate=0'], ('simulator: rate', '1 to 2000')),
        (['--set', 'simulator.speed=1'], ('unknown parameter', 'speed')),
        (['--set', 'plotter.rate=1'], ('unknown node', 'plotter')),
        (['--set', 'rate'], ('<node>.<parameter>=<value>',)),
        (['--set', 'controller.target_=[1'], ('unknown parameter', 'target_')),
        (['--set', 'simulator.rate=[1'], ('rate', 'expected a double', '[1')),
        (['--set', 'recorder.topics=[1'], ('topics', 'expected a string_array', '[1')),
        (['--set', 'recorder.topics=[a b]'], ('recorder: topics', 'names of topics', 'a b')),
        (['--namespace', 'bad name'], ('namespace', '/bad name')),
        (['--config', 'nowhere.yaml'], ('nowhere.yaml',)),
        (['--set', 'encoder.measure_delay=true'], ('measure_delay', 'realtime', 'lockstep')),
        (
            ['--set', 'encoder.observer=kalman', '--set', 'encoder.actuated_mass=122'],
            ('actuated_mass', '162, got 122', 'observer'),
        ),
        (['--markers', '--composed'], ('--markers with --composed', 'start `markers_node`')),
        (['--config', __file__], ('expected a ROS 2 parameter file',)),
    ],
)
def test_launcher_refuses_before_it_starts_anything(run_here, tmp_path, arguments, words):
    code, output = run_here('launcher', '--output', str(tmp_path / 'run'), *arguments)
    assert code == 2
    assert_one_clear_error(output, *words)
    assert not (tmp_path / 'run').exists()


@pytest.mark.parametrize('mode', [(), ('--composed',)], ids=['processes', 'composed'])
def test_launcher_passes_on_the_failure_of_a_node(domain, run_here, tmp_path, mode):
    run = run_here if mode else domain.run
    arguments = ['--output', str(tmp_path / 'run'), '--no-record', *mode]
    code, output = run('launcher', *arguments, '--target', 'simulation:8@1')
    assert code == 1
    assert_one_clear_error(output, 'controller', 'simulation:8@1')


def test_a_lone_simulator_gives_up_with_a_reason(domain):
    given = ros_arguments('expected_subscribers:=[launcher]', 'startup_timeout:=0.5')
    code, output = domain.run('simulator_node', *given)
    assert code == 1
    assert_one_clear_error(output, 'no control_force', 'startup_timeout = 0.5 s')


def test_a_broken_network_file(domain, tmp_path):
    content = {
        **json.loads(config_path('systems', 'paper_2.json').read_text()),
        'fixed': [0, 1, 2, 3, 400],
    }
    path = tmp_path / 'broken.json'
    path.write_text(json.dumps(content))
    code, output = domain.run('simulator_node', *ros_arguments(f'network:={path}'))
    assert code == 1
    assert_one_clear_error(output, 'broken.json', 'fixed', 'mass 400')
