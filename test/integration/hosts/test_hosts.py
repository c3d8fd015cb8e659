"""Body, brain and log on three hosts, on a network that is sound, and on some that are not."""

import json
import re
import subprocess
import sys
from itertools import pairwise

import numpy as np
import psutil
import pytest
from profiles import for_fast_dds_3
from rosbags.highlevel import AnyReader

from dpc_ros.bag import LOSSES_RECORD, read_run
from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.discovery import FAST_DDS, loaded_fast_dds
from dpc_ros.resources import config_path

pytestmark = pytest.mark.faults
LONG = pytest.mark.long  # where another case of the same is in every run
STEP = 5_000_000  # ns
FEW = 50  # steps
LOSSY = 'fast_dds_lossy.xml'
OUTAGE = 3.0  # s for which a cable is pulled
DELAY = 'delay 0.01 0.03'
LOSS = 'loss 0.1'
STRONGEST = 20.0  # N
TIMEOUT = 20  # steps, after which a force is stale
LOOP_TOPICS = ['configuration', 'latent_state', 'target', 'target_in_force', 'control_force']
STALE = {'simulator': 'control_force is stale', 'encoder': 'configuration is stale'}


@pytest.fixture
def lockstep(plan):
    return lambda steps: plan(simulator={'duration': steps * STEP * 1e-9})


@pytest.fixture
def realtime(plan):
    """Return a function: duration → plan of a run whose observer bridges the delay.

    With a law that asks for less than the default one, which is at its limit with such delays.
    """

    def make(duration):
        return plan(
            simulator={'time_mode': 'realtime', 'duration': duration},
            encoder={'observer': 'kalman', 'measure_delay': True},
            controller={
                'solve_in_background': True,
                'force_weight': 0.01,
                'expected_subscribers': ['simulator', 'encoder', 'recorder'],
            },
            recorder={'topics': [*LOOP_TOPICS, '/diagnostics']},
        )

    return make


@pytest.fixture
def use_profile(network, tmp_path):
    """Return a function: name of a shipped profile, addresses for it → all nodes have it."""

    def use(name, addresses=()):
        text = config_path(name).read_text()
        given = iter(addresses)
        text = re.sub('(?<=<address>).*(?=</address>)', lambda found: next(given), text)
        path = tmp_path / name
        fast_dds = loaded_fast_dds()
        path.write_text(text if fast_dds is FAST_DDS[0] else for_fast_dds_3(text))
        network.variables[fast_dds.variable] = str(path)

    return use


@pytest.mark.parametrize('how', ['multicast', 'static peers', 'a list of peers in a profile'])
def test_a_sound_network(network, how, lockstep, assert_repeats, use_profile, kept_promise):
    if how != 'multicast':
        network.forbid_multicast()
    if how == 'static peers':
        network.variables |= {
            'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
            'ROS_STATIC_PEERS': ';'.join(network.addresses),
        }
    elif how != 'multicast':
        network.variables['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'SYSTEM_DEFAULT'
        use_profile('fast_dds_unicast.xml', network.addresses)
    made = lockstep(200)
    network.start(made)
    network.wait_for_the_end()
    assert_repeats(made.bag, steps=200)
    kept_promise(
        f'three hosts that find each other by {how}',
        'the run is bit for bit the one in a single process, the log is complete',
        'lockstep',
        1,
    )


@pytest.mark.parametrize(
    ('fault', 'orders', 'is_cut', 'profile'),
    [
        pytest.param('frames delayed by 10–30 ms, out of order', [DELAY], False, None, marks=LONG),
        pytest.param('10 % of the frames lost', [LOSS], False, LOSSY, marks=LONG),
        pytest.param('a host cut off for 3 s', [], True, None, marks=LONG),
        ('frames delayed and lost, a host cut off for 3 s', [DELAY, LOSS], True, LOSSY),
    ],
)
def test_lockstep_on_a_bad_network(
    network, lockstep, assert_repeats, use_profile, kept_promise, fault, orders, is_cut, profile
):
    if profile:
        use_profile(profile)
    for order in orders:
        network.order(order)
    steps = FEW if orders else 1000
    made = lockstep(steps)
    network.start(made)
    if is_cut:
        network.wait_for_states(10)
        network.cut('brain', OUTAGE)
    network.wait_for_the_end()
    counts = network.counts()
    assert (counts['lost'] > 0) == (is_cut or LOSS in orders)
    assert (counts['overtaken'] > 0) == (DELAY in orders)
    assert_repeats(made.bag, steps=steps)
    kept_promise(
        fault,
        'the body waits; the run is bit for bit the one in a single process, the log is complete',
        'lockstep',
        1,
    )


def said_of_health(bag):
    """Return the values that each node reported, of each key all there were, in order."""
    found = {}
    with AnyReader([bag]) as reader:
        chosen = [each for each in reader.connections if each.topic == '/diagnostics']
        for connection, _, data in reader.messages(connections=chosen):
            for status in reader.deserialize(data, connection.msgtype).status:
                values = found.setdefault(status.name, {})
                for pair in status.values:
                    values.setdefault(pair.key, []).append(pair.value)
    return found


def assert_bounded(run):
    """Assert that the body was safe in a realtime run; return how many steps it was let go for.

    A force acts for so many steps after the state that it answers, and no longer: where the log has
    none that young, the body moves freely, bit for bit.
    """
    stamps = run.configuration_stamp
    missing = (stamps[-1] - stamps[0]) // STEP + 1 - len(stamps)
    told = int(run.metadata[LOSSES_RECORD]['/configuration'])
    assert missing <= run.losses['/configuration'] <= told
    assert np.isfinite(run.configuration).all()
    assert np.isfinite(run.velocity).all()
    assert np.linalg.norm(run.force, axis=1).max() <= STRONGEST * (1 + 1e-12)
    body = Body(Integrator(Mechanics(load_network('paper_2')), STEP * 1e-9), run.actuated_mass)
    free = 0
    for k, following in pairwise(range(len(stamps))):
        newest = np.searchsorted(run.force_stamp, stamps[k], side='right') - 1
        is_young = newest >= 0 and stamps[k] - run.force_stamp[newest] <= TIMEOUT * STEP
        if k and not is_young and stamps[following] - stamps[k] == STEP:
            body.configuration, body.velocity = run.configuration[k], run.velocity[k]
            body.advance(np.zeros(2))
            np.testing.assert_array_equal(body.configuration, run.configuration[following])
            free += 1
    return free


@pytest.mark.parametrize(
    ('fault', 'orders', 'is_cut', 'profile'),
    [
        ('frames delayed by 10–30 ms, out of order', [DELAY], False, None),
        pytest.param('10 % of the frames lost', [LOSS], False, LOSSY, marks=LONG),
        ('a host cut off for 3 s', [], True, None),
    ],
)
def test_realtime_on_a_bad_network(
    network, realtime, use_profile, kept_promise, fault, orders, is_cut, profile
):
    if profile:
        use_profile(profile)
    for order in orders:
        network.order(order)
    made = realtime(8.0 if is_cut else 5.0)
    network.start(made)
    if is_cut:
        network.wait_for_states(100)
        network.cut('brain', OUTAGE)
    network.wait_for_the_end()
    run = read_run(made.bag)
    free = assert_bounded(run)
    health = said_of_health(made.bag)
    if DELAY in orders:  # to the brain, and back
        assert float(health['encoder']['measured delay [ms]'][-1]) > 20
        assert float(health['encoder']['foreseen delay [ms]'][-1]) >= 20
    if is_cut:
        assert free > TIMEOUT
        for node, stale in STALE.items():
            assert stale in health[node]['watchdog']
        assert any('no new latent_state' in each for each in health['controller']['watchdog'])
        assert int(health['encoder']['lost: configuration'][-1]) > 0
        gap = np.diff(run.force_stamp).argmax()
        assert len(run.force_stamp) - gap > TIMEOUT  # control resumes
    kept_promise(
        fault,
        f'a force acts for at most {TIMEOUT} steps after its state; control resumes, the run ends '
        'by itself; losses and delay are reported',
        'realtime',
        1,
    )


def test_nothing_outlives_a_test_that_is_killed(start_switch):
    """Namespaces without a name end with their last process."""
    run = 'import subprocess, sys; subprocess.run(sys.argv[1:], stdin=subprocess.PIPE)'
    command = [sys.executable, '-S', '-c', run, *start_switch]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as test:
        hosts = [psutil.Process(number) for number in json.loads(test.stdout.readline()).values()]
        test.kill()
    _, alive = psutil.wait_procs(hosts, 60)
    assert not alive
