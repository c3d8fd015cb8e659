"""`compare` finds what differs, where it begins and how large it is, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros import cli
from dpc_ros.bag import NODE_PARAMETERS_RECORD, PARAMETERS_RECORD
from dpc_ros.bag.comparison import Deviation, compare
from dpc_ros.bag.comparison_table import comparison_table
from dpc_ros.control import LawSettings, Target, make_law, run_closed_loop
from dpc_ros.network import Body, Integrator

STEPS = 20
STEP = 5_000_000  # ns


@pytest.fixture(scope='module')
def run_with_gain(small_system, small_configurations, log_type, record):
    """Return a function: gain, folder of the log → a run of the small body, and its bag."""

    def run(gain, folder='runs/a'):
        system = small_system(3)
        law = make_law('reduced_equilibrium', system, LawSettings(gain, 0.5, 0.5))
        law.regulate(Target(configuration=small_configurations[20]))
        body = Body(Integrator(system.mechanics, 0.005), system.actuated_mass)
        run = run_closed_loop(body, system.autoencoder, law, STEPS)
        stamps = [STEP * k for k in range(STEPS + 1)]
        parameters = {
            '/**/controller': {'ros__parameters': {'proportional_gain': gain, 'law': 'x'}},
            '/**/recorder': {'ros__parameters': {'bag': folder}},
        }
        log = log_type(
            configuration=list(zip(stamps, run.configuration, run.velocity, strict=True)),
            latent=list(zip(stamps, run.latent, run.latent_velocity, strict=True)),
            force=list(zip(stamps, run.force, strict=True)),
            targets=[(0, small_configurations[20], False)],
            metadata={PARAMETERS_RECORD: {'yaml': yaml.safe_dump(parameters)}},
        )
        return run, record(log)

    return run


def test_a_changed_gain_is_found_and_shown(run_with_gain, capsys):
    (one, first), (other, second) = run_with_gain(2.0), run_with_gain(3.0)
    with pytest.raises(SystemExit) as caught:
        cli.main(['bag', 'compare', str(first), str(second)])
    assert caught.value.code == 1
    shown = capsys.readouterr().out
    assert 'controller.proportional_gain: 2.0 → 3.0' in shown
    assert 'controller.law' not in shown
    assert '/target  equal' in shown
    found = compare(first, second)
    assert not found.is_equal
    assert found.parameters == {'controller.proportional_gain': (2.0, 3.0)}
    topics = {topic.topic: topic for topic in found.topics}
    # The body is at first where it was: the force comes first to differ, then the state.
    for topic, values, name in (
        ('/control_force', [run.force[:, 0] for run in (one, other)], 'wrench.force.x'),
        ('/configuration', [run.configuration for run in (one, other)], 'position'),
    ):
        a, b = (np.reshape(array, (STEPS + 1, -1)) for array in values)
        difference = topics[topic].first
        index = np.flatnonzero((a != b).any(axis=1))[0]
        place = np.flatnonzero(a[index] != b[index])[0]
        assert (difference.index, difference.stamp_ns) == (index, STEP * index)
        assert difference.field == (name if a.shape[1] == 1 else f'{name}[{place}]')
        assert (difference.first, difference.second) == (a[index, place], b[index, place])
        largest = np.abs(a - b).max()
        assert topics[topic].deviations[name] == Deviation(largest, largest / np.abs(a).max())
    assert topics['/control_force'].first.index < topics['/configuration'].first.index


def test_the_same_run_again_is_equal_wherever_its_log_lies(run_with_gain, capsys):
    (_, first), (_, second) = run_with_gain(2.0), run_with_gain(2.0, 'runs/b')
    cli.main(['bag', 'compare', str(first), str(second)])
    shown = capsys.readouterr().out
    assert shown.endswith('\nequal\n')
    assert 'recorder.bag: runs/a → runs/b' in shown, 'it is shown all the same'


@settings(max_examples=12)
@given(
    changed=st.dictionaries(st.integers(0, 9), st.floats(1e-9, 10), max_size=4),
    tolerance=st.sampled_from([0.0, 1e-6, 0.1]),
    repeated=st.lists(st.integers(0, 9), max_size=3),
    dropped=st.sets(st.integers(0, 9), max_size=2),
)
def test_what_was_changed_is_what_is_found(changed, tolerance, repeated, dropped, log_type, record):
    rows = [(STEP * k, [float(k), 8.0], [0.0, 0.0]) for k in range(10)]
    other = [
        (t, [q[0] + changed.get(k, 0.0), q[1]], v)
        for k, (t, q, v) in enumerate(rows)
        if k not in dropped
    ]
    # The simulator says a state again, until it is answered.
    other = [row for row in other for _ in range(1 + repeated.count(row[0] // STEP))]
    found = compare(
        record(log_type(configuration=rows)), record(log_type(configuration=other)), tolerance
    )
    (topic,) = (each for each in found.topics if each.topic == '/configuration')
    deviations = {k: abs((k + d) - k) for k, d in changed.items() if k not in dropped}
    # 9 is the largest magnitude of the field.
    over = sorted(k for k, deviation in deviations.items() if deviation > tolerance * 9)
    assert topic.only == (len(dropped), 0)
    assert topic.different == len(over)
    assert found.is_equal == (not over and not dropped)
    assert (topic.first is None) == (not over)
    if over:
        assert topic.first.stamp_ns == STEP * over[0]
        assert topic.first.field == 'position[0]'
    largest = max(deviations.values(), default=0.0)
    assert topic.deviations.get('position', Deviation(0.0, 0.0)).absolute == largest


def test_every_message_counts_whatever_its_stamp(log_type, record):
    def log(second_epoch=1.0, targets=(1.0, 2.0, 1.0)):
        states = [(STEP * k, [float(k)], [0.0]) for k in (0, 0, 1, 2)]
        again = [(t, [second_epoch * q[0]], v) for t, q, v in states]
        goals = [(0, [target], False) for target in targets]  # all at once: without a stamp
        return record(log_type(configuration=states + again, targets=goals))

    one = log()
    topics = {topic.topic: topic for topic in compare(one, log()).topics}
    assert all(topic.is_equal for topic in topics.values())
    assert topics['/configuration'].distinct == (6, 6)
    assert topics['/target'].distinct == (3, 3)
    topics = {topic.topic: topic for topic in compare(one, log(second_epoch=2.0)).topics}
    assert topics['/configuration'].different == 2
    assert topics['/configuration'].first.index == 4
    for targets, different, only in (
        ((1.0, 2.0, 3.0), 1, (0, 0)),
        ((1.0, 2.0), 0, (1, 0)),
        ((1.0, 2.0, 1.0, 2.0), 0, (0, 1)),
    ):
        topics = {topic.topic: topic for topic in compare(one, log(targets=targets)).topics}
        assert (topics['/target'].different, topics['/target'].only) == (different, only)
        assert not topics['/target'].is_equal


@pytest.mark.parametrize(('node', 'is_equal'), [('recorder', True), ('recorder_arm', False)])
def test_parameters_of_a_recorder_in_a_namespace_say_how_a_log_is_kept(
    log_type, record, node, is_equal
):
    def log(folder):
        name = f'/lab/body/{node}'
        text = yaml.safe_dump({name: {'ros__parameters': {'bag': folder}}})
        metadata = {NODE_PARAMETERS_RECORD: {name: text}}
        return record(log_type(configuration=[(0, [1.0], [0.0])], metadata=metadata))

    assert compare(log('runs/a'), log('runs/b')).is_equal == is_equal


def test_no_number_equals_itself_only(log_type, record):
    rows = [(1, [np.nan, np.inf, 1.0], [0.0] * 3)]
    one = record(log_type(configuration=rows))
    assert compare(one, record(log_type(configuration=rows))).is_equal
    for values in ([0.0, np.inf, 1.0], [np.nan, -np.inf, 1.0], [np.nan, np.inf, np.nan]):
        other = record(log_type(configuration=[(1, values, [0.0] * 3)]))
        assert not compare(one, other, tolerance=1e3).is_equal


def test_other_topics_types_sizes_and_texts_are_differences(small_log, log_type, record):
    one = record(small_log)
    for other, words in (
        (replace(small_log, force=[]), 'in the first log only'),
        (replace(small_log, checkpoint='other@1'), 'header.frame_id: flat@ba98'),
        (
            replace(small_log, latent=[(t, [*x, 0.0], [*v, 0.0]) for t, x, v in small_log.latent]),
            "name: ['xi_0', 'xi_1'] → ",
        ),
        (replace(small_log, targets=[(0, [1.0], False)]), 'position: 4 values → 1 values'),
        (replace(small_log, targets=[(0, [1.0], True)]), "name: [] → ['xi_0']"),
    ):
        found = compare(one, record(other))
        assert not found.is_equal
        assert words in comparison_table(found)


def test_which_controller_commands_does_not_count(small_log, record):
    twice = [row for row in small_log.force for _ in range(2)]  # two processes say the same
    for frames in (('mass_0@1f3a9c02',), ('mass_0@1f3a9c02', 'mass_0@00000001')):
        one = record(replace(small_log, force_frames=frames, force=twice))
        for others in (('mass_0',), ('mass_0@ffffffff',)):
            assert compare(one, record(replace(small_log, force_frames=others))).is_equal
        assert not compare(one, record(replace(small_log, force_frames=('mass_1',)))).is_equal


def test_a_tolerance_below_zero_is_refused(small_log, record):
    bag = record(small_log)
    with pytest.raises(ValueError, match='tolerance: expected a number ≥ 0'):
        compare(bag, bag, tolerance=-1.0)
