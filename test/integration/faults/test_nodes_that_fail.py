"""A node that dies or hangs: the body is left alone, and the loop goes on when the node does."""

from itertools import pairwise, takewhile
from time import time

import numpy as np
import pytest

pytestmark = pytest.mark.faults
LONG = pytest.mark.long  # where another case of the same is in every run
TIMEOUT = 0.1  # s, after which a force is stale
FORCED_STEPS = round(TIMEOUT * 200) + 1  # that one of the state which the force answers
MOST_STARTS = 20  # repetitions in which a process is started anew, which takes seconds


@pytest.fixture
def repetitions(repetitions, request):
    return min(repetitions, MOST_STARTS) if 'killed' in request.node.name else repetitions


def epochs(states):
    """Return the states of each simulator, in order, those published twice once."""
    found = [[]]
    for state in states:
        if found[-1] and state.stamp < found[-1][-1].stamp:
            found.append([])
        if not found[-1] or state.stamp > found[-1][-1].stamp:
            found[-1].append(state)
    return found


@pytest.fixture
def assert_repeats_states(in_process):
    """Assert that states are the first ones of the closed loop in one process, bit for bit."""

    def check(states):
        expected = in_process(steps=len(states) - 1)
        assert [state.stamp for state in states] == [5_000_000 * k for k in range(len(states))]
        found = np.array([state.configuration for state in states])
        np.testing.assert_array_equal(found, expected.configuration)

    return check


def freedom(loop, moved_by, since):
    """Wait until the body moves freely; return when [s], and for how many steps it was forced.

    Those of the last force that has come: it may have been late, and the body free before it.
    """
    nothing = np.zeros(2)
    found = []

    def is_free():
        last = next(each for each in reversed(loop.forces) if each.force.any())
        states = [*takewhile(lambda state: state.sent >= last.sent, reversed(loop.states))]
        steps = [*pairwise(reversed(states))]
        forced = [*takewhile(lambda step: not moved_by(nothing, *step), steps)]
        found[:] = [(after.sent, len(forced)) for _, after in steps[len(forced) :][:1]]
        return found and loop.states[-1].sent > since

    loop.observer.wait(is_free, 'a step without force')
    return found[0]


@pytest.mark.parametrize('kind', ['encoder', pytest.param('controller', marks=LONG)])
def test_lockstep_waits_for_a_killed_node(
    loop, kind, assert_repeats_states, repetitions, kept_promise
):
    running = loop('lockstep')
    recovery = []
    for _ in range(repetitions):
        running.kill(kind)
        killed = time()
        running.start(kind)
        recovery.append(running.go_on(40, since=killed))
    running.stop()
    (states,) = epochs(running.states)
    assert_repeats_states(states)
    kept_promise(
        f'{kind} killed (`kill -9`) and started anew',
        'the body waits, then goes on bit for bit as if nothing had happened',
        'lockstep',
        repetitions,
        recovery=recovery,
    )


@LONG
def test_lockstep_begins_anew_with_a_killed_simulator(
    loop, assert_repeats_states, repetitions, kept_promise
):
    running = loop('lockstep')
    recovery = []
    for _ in range(repetitions):
        running.kill('simulator')
        killed = time()
        running.start('simulator')
        recovery.append(running.go_on(40, since=killed))
    running.stop()
    found = epochs(running.states)
    assert len(found) == repetitions + 1
    for states in found:
        assert_repeats_states(states)
    kept_promise(
        'simulator killed (`kill -9`) and started anew',
        'the body begins at rest, and every run is bit for bit the first one',
        'lockstep',
        repetitions,
        recovery=recovery,
    )


@pytest.mark.parametrize(
    ('fault', 'kind'),
    [
        ('killed', 'controller'),
        ('stopped', 'encoder'),
        pytest.param('killed', 'encoder', marks=LONG),
        pytest.param('stopped', 'controller', marks=LONG),
    ],
)
def test_a_body_whose_brain_is_gone_is_left_alone(
    loop, kind, fault, moved_by, repetitions, kept_promise
):
    running = loop('realtime', simulator={'force_timeout': TIMEOUT})
    reaction, recovery = [], []
    for _ in range(repetitions):
        failed = (running.kill if fault == 'killed' else running.pause)(kind)
        free, forced_steps = freedom(running, moved_by, failed)
        assert forced_steps <= FORCED_STEPS
        reaction.append(free - failed)
        if fault == 'stopped':
            running.wait_for_states(400)
        began = time()
        (running.start if fault == 'killed' else running.unpause)(kind)
        # It answers what it has missed, too, which moves nothing.
        recovery.append(running.go_on(40, since=began, within=TIMEOUT))
    assert all(np.isfinite(state.configuration).all() for state in running.states)
    running.stop()
    how = 'killed (`kill -9`) and started anew' if fault == 'killed' else 'stopped for 2 s'
    kept_promise(
        f'{kind} {how}',
        f'the last force acts for {FORCED_STEPS} steps at most, then none; control resumes',
        'realtime',
        repetitions,
        reaction,
        recovery,
    )


@pytest.mark.parametrize(
    'kind', ['controller', *(pytest.param(kind, marks=LONG) for kind in ('simulator', 'encoder'))]
)
def test_lockstep_waits_for_a_stopped_node(
    loop, kind, assert_repeats_states, repetitions, kept_promise, passed
):
    running = loop('lockstep')
    recovery = []
    for _ in range(repetitions):
        running.pause(kind)
        passed(2.0)
        began = time()
        running.unpause(kind)
        recovery.append(running.go_on(40, since=began))
    running.stop()
    (states,) = epochs(running.states)
    assert_repeats_states(states)
    kept_promise(
        f'{kind} stopped for 2 s (`SIGSTOP`)',
        'the body waits, then goes on bit for bit as if nothing had happened',
        'lockstep',
        repetitions,
        recovery=recovery,
    )


@LONG
@pytest.mark.parametrize('fault', ['killed', 'stopped'])
def test_control_goes_on_with_the_simulator(loop, fault, repetitions, kept_promise, passed):
    running = loop('realtime', simulator={'force_timeout': TIMEOUT})
    recovery = []
    for _ in range(repetitions):
        if fault == 'killed':
            running.kill('simulator')
            began = time()
            running.start('simulator')
        else:
            running.pause('simulator')
            passed(2.0)
            began = time()
            running.unpause('simulator')
        recovery.append(running.go_on(40, since=began))
    found = epochs(running.states)
    assert len(found) == (repetitions + 1 if fault == 'killed' else 1)
    for states in found:
        # Steps are neither left out nor made up for in a burst of stamps.
        assert {after.stamp - before.stamp for before, after in pairwise(states)} == {5_000_000}
        assert all(np.isfinite(state.configuration).all() for state in states)
    running.stop()
    how = 'killed (`kill -9`) and started anew' if fault == 'killed' else 'stopped for 2 s'
    promise = 'the body begins at rest' if fault == 'killed' else 'the body goes on where it was'
    kept_promise(
        f'simulator {how}',
        f'{promise}; control resumes',
        'realtime',
        repetitions,
        recovery=recovery,
    )
