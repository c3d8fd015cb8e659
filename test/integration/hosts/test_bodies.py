"""Many bodies on one domain, each on a host and in a namespace of its own: what they cost."""

import json
import statistics
import time
from pathlib import Path

import psutil
import pytest

from dpc_ros.nodes.launch_plan import LOOP
from dpc_ros.resources import config_path

NEWCOMER = Path(__file__).with_name('newcomer.py').read_text()
MARK = 'answer '
SLOWNESS = 20  # times as slow as the wall clock: 10 steps a second, which 16 bodies can have here
REPORTS = 10  # of each node, one a second
INTERRUPTED = 130  # exit code after Ctrl-C
LONG = pytest.mark.long


@pytest.fixture
def hosts(bodies):
    """A host for each body, and one for who comes last."""
    return [f'host_{number}' for number in range(1, bodies + 1)] + ['last']


@pytest.mark.faults
@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    'bodies',
    [pytest.param(1, marks=LONG), 2, pytest.param(4, marks=LONG), pytest.param(16, marks=LONG)],
)
def test_bodies_on_one_domain(network, kept_promise, tmp_path, bodies):
    *homes, last = network.hosts
    for host in homes:
        network.launch(
            host,
            *('--config', str(config_path('demo.yaml')), '--output', str(tmp_path / host)),
            *('--composed', '--no-record', '--namespace', host, '--realtime', '--duration', '0'),
            *('--set', f'simulator.real_time_factor={1 / SLOWNESS}'),
            *('--set', 'simulator.force_timeout=1', '--set', 'controller.latent_timeout=1'),
        )
    launchers = [network.nodes[host] for host in homes]
    newcomer = network.start_script(last, NEWCOMER, str(len(LOOP) * bodies), str(REPORTS))
    discovery = answer_of(newcomer)
    began, spent = time.monotonic(), processor_time(launchers)
    reports = answer_of(newcomer)
    cores = (processor_time(launchers) - spent) / (time.monotonic() - began)
    assert {*reports} == {f'/{host}/{kind}' for host in homes for kind in LOOP}
    for name, values in reports.items():
        assert {*values['rejected']} == {'0'}, name
        assert int(values['published'][-1]) > int(values['published'][0]), name
    for launcher in launchers:
        code, said = network.domain.stop(launcher)
        assert code == INTERRUPTED, said
    simulators = [reports[f'/{host}/simulator'] for host in homes]
    trips = {
        which: statistics.median(
            float(value) for values in simulators for value in values[f'round trip {which} [ms]']
        )
        for which in ('p50', 'p99')
    }
    kept_promise(
        f'{bodies} bodies, each on a host and in a namespace of its own',
        'each has its own loop, which goes on; a newcomer finds all nodes',
        f'realtime, {200 // SLOWNESS} steps a second',
        1,
        bodies=bodies,
        cores=cores,
        discovery_s=discovery,
        round_trip_p50_ms=trips['p50'],
        round_trip_p99_ms=trips['p99'],
    )


def answer_of(newcomer):
    """Return its next answer; other lines may come between, of DDS for one."""
    others = []
    for line in newcomer.stdout:
        if line.startswith(MARK):
            return json.loads(line.removeprefix(MARK))
        others.append(line)
    pytest.fail(''.join(others))


def processor_time(processes):
    """Return what some processes, and those that they have started, have used [s]."""
    total = 0.0
    for process in processes:
        started = psutil.Process(process.pid)
        for each in [started, *started.children(recursive=True)]:
            times = each.cpu_times()
            total += times.user + times.system
    return total
