"""Real processes over real DDS, each test on a domain of its own."""

import contextlib
import gc
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
import rclpy
from domain_coordinator import domain_id
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from dpc_ros.autoencoder import load_checkpoint, with_encoder
from dpc_ros.bag import LOSSES_RECORD, read_raw, read_run
from dpc_ros.control import LatentObserver, LawSettings, load_target, make_law, run_closed_loop
from dpc_ros.network import Body, Integrator, Mechanics, load_network
from dpc_ros.nodes.discovery import FAST_DDS, prompt_dds
from dpc_ros.nodes.launch_plan import LaunchPlan, make_plan
from dpc_ros.reduction import CompressedSystem
from dpc_ros.resources import config_path
from dpc_ros.threads import single_threaded_algebra

GIVE_UP = 120.0  # s after which a test stops waiting; nothing is asserted about the time itself
DEMO = config_path('demo.yaml')


def shared_memory() -> set[Path]:
    """Return what Fast DDS has in shared memory, whoever it belongs to."""
    return {*Path('/dev/shm').glob('*fast*')}


def sockets_here() -> set[str]:
    """Return the UDP sockets of this process: nodes that are not gone have some."""
    rows = Path('/proc/self/net/udp').read_text().splitlines()[1:]
    udp = {f'socket:[{row.split()[9]}]' for row in rows}
    found = set()
    for descriptor in Path('/proc/self/fd').iterdir():
        with contextlib.suppress(OSError):
            found.add(str(descriptor.readlink()))
    return found & udp


@dataclass
class Domain:
    """A DDS domain of its own: processes started on it end with the test."""

    number: int
    processes: list[subprocess.Popen] = field(default_factory=list)
    memory: set[Path] = field(default_factory=shared_memory)  # of others, before the test

    @property
    def environment(self) -> dict[str, str]:
        own = ('OMP_NUM_THREADS', *(each.variable for each in FAST_DDS))  # of this process
        return {
            **{name: value for name, value in os.environ.items() if name not in own},
            'ROS_DOMAIN_ID': str(self.number),
            'PYTHONUNBUFFERED': '1',
            'PYTHONFAULTHANDLER': '1',
        }

    def start(
        self,
        module: str,
        *arguments: str,
        cwd: Path | None = None,
        through: Iterable[str] = (),
        **variables: str,
    ) -> subprocess.Popen:
        command = ['-m', f'dpc_ros.nodes.{module}', *arguments]
        return self._start(command, {**self.environment, **variables}, cwd, through)

    def start_script(
        self, script: str, *arguments: str, through: Iterable[str] = (), **variables: str
    ) -> subprocess.Popen:
        environment = {**self.environment, **variables}
        return self._start(['-c', script, *arguments], environment, through=through)

    def _start(
        self,
        arguments: list[str],
        environment: dict[str, str],
        cwd: Path | None = None,
        through: Iterable[str] = (),
    ) -> subprocess.Popen:
        process = subprocess.Popen(
            [*through, sys.executable, *arguments],
            env=environment,
            cwd=cwd,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            pipesize=2**20,  # it is read at the end, and who finds it full stands still
        )
        self.processes.append(process)
        return process

    def start_node(
        self, kind: str, plan: LaunchPlan, through: Iterable[str] = (), **variables: str
    ) -> subprocess.Popen:
        """Start a node, where a command that runs another is given, through that."""
        return self.start(f'{kind}_node', *plan.ros_arguments(), through=through, **variables)

    def run(self, module: str, *arguments: str, cwd: Path | None = None) -> tuple[int, str]:
        process = self.start(module, *arguments, cwd=cwd)
        output, _ = process.communicate(timeout=GIVE_UP)
        return process.returncode, output

    def kill(self, process: subprocess.Popen) -> float:
        """Kill a process.

        Returns:
            when it was killed, by the clock of `time.time` [s].
        """
        killed = time.time()
        process.kill()
        process.wait()
        process.stdout.close()
        return killed

    def assert_memory_is_clean(self) -> None:
        """Assert that nothing is left in shared memory; what other programs have there goes by."""
        deadline = time.monotonic() + GIVE_UP
        while not shared_memory() <= self.memory:
            assert time.monotonic() < deadline, f'left: {shared_memory() - self.memory}'
            time.sleep(0.1)

    def stop(self, process: subprocess.Popen) -> tuple[int, str]:
        if process.poll() is None:
            with contextlib.suppress(OSError):  # it ends just now
                maps = Path(f'/proc/{process.pid}/maps').read_text()
                assert not re.findall('/dev/shm/fast.*', maps), 'it shares memory'
            process.send_signal(signal.SIGINT)
        try:
            output, _ = process.communicate(timeout=GIVE_UP)
        except subprocess.TimeoutExpired:
            has_ended = process.poll() is not None  # and another process has its output
            process.send_signal(signal.SIGABRT)  # it prints where it is
            with contextlib.suppress(subprocess.TimeoutExpired):
                output, _ = process.communicate(timeout=10)
                pytest.fail(f'it does not stop:\n{output}')
            pytest.fail(f'it does not stop, or another process has its output: {has_ended=}')
        return process.returncode, output


@pytest.fixture(autouse=True)
def read_every_log(tmp_path, assert_readers_agree):
    """Whatever a test has recorded, all readers find the same in it."""
    yield
    for metadata in tmp_path.rglob('metadata.yaml'):
        assert_readers_agree(metadata.parent)


@pytest.fixture(scope='session', autouse=True)
def only_what_tests_make_is_collected():
    """What has been loaded stays, and looking for garbage in it took longer than many a test."""
    gc.collect()
    gc.freeze()
    yield
    gc.unfreeze()


@pytest.fixture
def domain():
    with domain_id() as number:
        domain = Domain(number)
        sockets = sockets_here()
        yield domain
        if not sockets_here() <= sockets:
            gc.collect()  # a node and its callbacks refer to each other
        for process in domain.processes:
            if process.poll() is None:
                process.terminate()
        for process in domain.processes:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            domain.kill(process)
        assert sockets_here() <= sockets, 'a node in the process of the test was not destroyed'


@pytest.fixture
def observer(domain):
    """A node of the test itself on the domain, with an executor to spin."""
    context = Context()
    with prompt_dds():
        rclpy.init(context=context, domain_id=domain.number)
    node = rclpy.create_node('observer', context=context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(node)
    yield Observer(node, executor)
    executor.shutdown()
    node.destroy_node()
    context.try_shutdown()


@pytest.fixture
def run_here(observer):
    """Return a function: a lifecycle node of ours → it runs in the process of the test.

    Nothing may keep it afterwards: it is gone only when Python has freed it.
    """
    nodes = []

    def run(node):
        nodes.append(node)
        observer.executor.add_node(node)
        return node

    yield run
    while nodes:
        observer.executor.remove_node(nodes[-1])
        nodes.pop().close()
    observer.executor.spin_once(timeout_sec=0.0)  # it forgets what it ran last, and whose that was


@dataclass
class Observer:
    """Spins until something has happened."""

    node: Node
    executor: SingleThreadedExecutor

    def wait(self, condition, what: str) -> None:
        deadline = time.monotonic() + GIVE_UP
        while not condition():
            assert time.monotonic() < deadline, f'gave up waiting for {what}'
            self.executor.spin_once(timeout_sec=0.05)

    def wait_for_node(self, name: str) -> None:
        self.wait(lambda: name in self.node.get_node_names(), f'the node {name}')


@pytest.fixture
def plan(tmp_path):
    """Make the plan of a run whose nodes a test starts itself."""

    def make(folder: str = 'run', record: bool = True, **overrides) -> LaunchPlan:
        recorder = ['recorder'] if record else []
        merged = {
            'simulator': {'expected_subscribers': ['encoder', *recorder]},
            'encoder': {'expected_subscribers': ['controller', *recorder]},
            'controller': {'expected_subscribers': ['simulator', *recorder]},
        }
        for kind, values in overrides.items():
            merged.setdefault(kind, {}).update(values)
        made = make_plan(DEMO, merged, tmp_path / folder, record=record)
        made.write()
        return made

    return make


@pytest.fixture(scope='session')
def in_process():
    """Return a function: the demonstration's closed loop in one process, without ROS."""

    def run(
        checkpoint='paper_2_extended_m5',
        encoder='network',
        steps=1000,
        mass=162,
        target='simulation:4@100',
        law_name='lqr',
        observer=None,
        **settings,
    ):
        single_threaded_algebra()
        network = load_network('paper_2')
        mechanics = Mechanics(network)
        autoencoder = with_encoder(load_checkpoint(checkpoint).autoencoder(), encoder)
        system = CompressedSystem(mechanics, autoencoder, mass)
        law = make_law(law_name, system, LawSettings(largest_force=20.0, **settings))
        law.regulate(load_target(target, network))
        body = Body(Integrator(mechanics, 0.005), mass)
        estimates = LatentObserver(system, observer) if observer is not None else None
        return run_closed_loop(body, autoencoder, law, steps, observer=estimates)

    return run


@pytest.fixture(scope='session')
def reference(in_process):
    """The demonstration as it is."""
    return in_process()


@pytest.fixture
def assert_repeats(reference):
    """Assert that a bag holds an in-process run, or its first steps, and return what was read.

    Bit for bit. What a node that was killed said last may have reached one reader and not another:
    of each topic in `killed` one message may be missing in the log.
    """

    def check(bag: Path, reference=reference, steps=None, killed=()):
        run = read_run(bag)
        states = slice(None if steps is None else steps + 1)
        stamps = np.arange(len(reference.configuration))[states] * 5_000_000
        for topic, others in (
            ('configuration', ['velocity']),
            ('latent', ['latent_velocity']),
            ('force', []),
        ):
            logged = getattr(run, f'{topic}_stamp')
            is_logged = np.isin(stamps, logged)
            assert np.count_nonzero(~is_logged) <= (topic in killed), topic
            np.testing.assert_array_equal(logged, stamps[is_logged])
            for name in (topic, *others):
                expected = getattr(reference, name)[states][is_logged]
                np.testing.assert_array_equal(getattr(run, name), expected)
        assert not any(run.losses.values()), run.losses
        return run

    return check


@pytest.fixture
def assert_nothing_lost():
    """Assert that a log holds each message of the loop from the first on; return what was read."""

    def check(bag: Path):
        numbers = {'/configuration': [], '/latent_state': [], '/control_force': []}
        for message in read_raw(bag, numbers):
            numbers[message.topic].append(message.sequence)
        for topic, found in numbers.items():
            assert found == list(range(1, len(found) + 1)), topic
        run = read_run(bag)
        assert set(run.metadata[LOSSES_RECORD].values()) == {'0'}
        return run

    return check
