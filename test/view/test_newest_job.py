"""Of the jobs that wait only the newest is done, and all are done in one other thread."""

import threading
from queue import SimpleQueue

import pytest

from dpc_ros.view.newest_job import NewestJob

LONGEST_WAIT = 60  # s


@pytest.fixture
def failures():
    return SimpleQueue()


@pytest.fixture
def worker(failures):
    worker = NewestJob(failures.put)
    yield worker
    worker.close()


@pytest.fixture
def hold(worker):
    """Keep the worker busy, and return what lets it go on."""
    began, go_on = threading.Event(), threading.Event()

    def wait():
        began.set()
        go_on.wait(LONGEST_WAIT)

    worker.ask(wait)
    assert began.wait(LONGEST_WAIT)
    yield go_on
    go_on.set()


def test_what_came_while_a_job_was_done_is_left_out_but_for_the_newest(worker, hold):
    done = SimpleQueue()
    for name in ('first', 'second', 'third'):
        worker.ask(lambda name=name: done.put(name))
    hold.set()
    assert done.get(timeout=LONGEST_WAIT) == 'third'
    assert done.empty()


def test_what_must_be_done_is_done_before_what_came_after_it(worker, hold):
    done = SimpleQueue()
    worker.ask(lambda: done.put('left out'))
    worker.ask(lambda: done.put('must'), must=True)
    worker.ask(lambda: done.put('newest'))
    hold.set()
    assert done.get(timeout=LONGEST_WAIT) == 'must'
    assert done.get(timeout=LONGEST_WAIT) == 'newest'


def test_a_job_that_fails_is_told_and_the_next_one_is_done(worker, failures):
    done = threading.Event()

    def fail():
        raise RuntimeError('no such thing')

    worker.ask(fail, must=True)
    worker.ask(done.set)
    assert failures.get(timeout=LONGEST_WAIT) == 'RuntimeError: no such thing'
    assert done.wait(LONGEST_WAIT)
