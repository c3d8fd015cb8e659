"""What one set of parameters asks for is held against every declaration before any of it counts."""

import math

import pytest
from rclpy.parameter import Parameter

from dpc_ros.control import LAW_PARAMETERS
from dpc_ros.nodes.launch_plan import make_plan
from dpc_ros.nodes.parameters import changed_settings
from dpc_ros.parameters import KINDS, ParameterError, declarations, node_parameters
from dpc_ros.resources import config_path

NUMBERS = [
    (kind, declaration)
    for kind in KINDS
    for declaration in declarations(kind).values()
    if declaration.type in ('double', 'integer')
]


@pytest.mark.parametrize(
    ('kind', 'declared'), NUMBERS, ids=lambda each: getattr(each, 'name', each)
)
def test_what_is_no_number_or_out_of_range_is_refused_with_the_range(kind, declared):
    settings = node_parameters(kind)
    bad = [declared.range[0] - 1, 2 * declared.range[1] + 1]
    if declared.type == 'double':
        bad += [math.nan, math.inf, -math.inf]
    for value in bad:
        with pytest.raises(
            ParameterError, match=f'{declared.name}: expected {declared.range[0]:g}'
        ):
            changed_settings(kind, settings, [Parameter(declared.name, value=value)])


def test_one_bad_value_refuses_the_whole_set():
    settings = node_parameters('encoder')
    good = Parameter('projection_iterations', value=7)
    changed = changed_settings('encoder', settings, [good, Parameter('use_sim_time', value=True)])
    assert changed == {**settings, 'projection_iterations': 7}
    for bad in (Parameter('encoder', value='none of them'), Parameter('delay', value='late')):
        with pytest.raises(ParameterError, match=f'{bad.name}: expected'):
            changed_settings('encoder', settings, [good, bad])


def test_of_a_controller_all_that_its_law_depends_on_can_be_set_while_it_runs():
    live = {name for name, each in declarations('controller').items() if each.live}
    assert live == set(LAW_PARAMETERS)


@pytest.mark.parametrize('mode', ['lockstep', 'realtime'])
def test_the_launcher_lets_the_controller_solve_in_the_background_in_realtime_only(tmp_path, mode):
    made = make_plan(config_path('demo.yaml'), {'simulator': {'time_mode': mode}}, tmp_path / 'run')
    assert made.parameters['controller']['solve_in_background'] == (mode == 'realtime')
    given = {'simulator': {'time_mode': mode}, 'controller': {'solve_in_background': False}}
    made = make_plan(config_path('demo.yaml'), given, tmp_path / 'run')
    assert not made.parameters['controller']['solve_in_background']
