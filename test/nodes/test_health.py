"""What a node reports of itself: losses, rejections, what is wrong at the moment."""

import sys
import time

import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.nodes.health import WATCHDOG_OK, Health, Reasons, SequenceCounter


def count(numbers, publishers=1):
    counter = SequenceCounter()
    return sum(counter.gap(number, lambda: publishers) for number in numbers)


@given(first=st.integers(1, 100), lost=st.sets(st.integers(1, 48)))
def test_with_one_publisher_the_losses_between_two_messages_are_exact(first, lost):
    numbers = [first + k for k in range(50) if k not in lost]
    assert count(numbers) == len(lost)
    assert count([*numbers, *range(1, 10)]) == len(lost), 'another publisher has taken over'


@given(
    firsts=st.lists(st.integers(1, 20), min_size=1, max_size=4),
    draws=st.lists(st.integers(0, 3), max_size=80),
)
def test_with_several_publishers_no_loss_is_invented(firsts, draws):
    following = list(firsts)
    numbers = []
    for draw in draws:
        publisher = draw % len(firsts)
        numbers.append(following[publisher])
        following[publisher] += 1
    assert count(numbers, len(firsts)) == 0


@given(texts=st.lists(st.sampled_from('abcdefgh')), most=st.integers(1, 5))
def test_of_many_reasons_the_last_are_told_apart_and_none_is_lost_in_the_sum(texts, most):
    reasons = Reasons(most)
    for text in texts:
        reasons[text] += 1
    told = [text for text, _ in reasons.items()]
    last = list(dict.fromkeys(reversed(texts)))[:most]
    assert told == last[::-1]
    assert reasons.total() == len(texts)
    assert all(number <= texts.count(text) for text, number in reasons.items())


def test_a_publisher_that_makes_up_reasons_fills_no_memory():
    health = Health()
    number, size = 100_000, 10_000
    for k in range(number):
        health.rejected[f'target: expected a frame, got {k}'] += 1
    for k in range(100):
        health.rejected[f'{k} {"x" * size}'] += 1
    status = health.report('node', '/node', 'active')
    kept = [pair for pair in status.values if pair.key.startswith('rejected: ')]
    assert len(kept) < 50
    assert sum(sys.getsizeof(pair.key) for pair in kept) < size
    assert sum(int(pair.value) for pair in kept) == number + 100
    assert values(status)['rejected'] == str(number + 100)


def values(status):
    return {pair.key: pair.value for pair in status.values}


def report(health, failure=''):
    return health.report('node', '/body/node', 'active', failure)


@pytest.mark.parametrize('what', ['rejected', 'lost'])
def test_trouble_is_a_warning_for_a_while_and_counted_for_ever(what):
    health = Health()
    assert report(health).level == DiagnosticStatus.OK
    getattr(health, what)['topic'] += 3
    levels = [report(health).level for _ in range(8)]
    assert levels == [DiagnosticStatus.WARN] * 5 + [DiagnosticStatus.OK] * 3
    assert values(report(health))[what] == '3'


def test_what_is_wrong_at_the_moment_is_the_message():
    health = Health()
    health.watchdog = WATCHDOG_OK
    assert (report(health).level, report(health).message) == (DiagnosticStatus.OK, 'active')
    health.watchdog = 'control_force is stale'
    assert report(health).level == DiagnosticStatus.WARN
    assert report(health).message == values(report(health))['watchdog'] == health.watchdog
    health.warning = 'the clocks differ'
    assert report(health).message == health.warning
    failed = report(health, 'the body diverged')
    assert (failed.level, failed.message) == (DiagnosticStatus.ERROR, 'the body diverged')


def test_keys_are_the_same_whether_or_not_anything_was_measured():
    health = Health()
    empty = values(report(health))
    now = time.time_ns()
    for stamp in range(10):
        health.arrived({'source_timestamp': now - 2_000_000, 'received_timestamp': now})
        health.sent()
        health.processed(0.001 * stamp)
        health.round_trips.sent(stamp)
        health.round_trips.answered(stamp)
    filled = values(report(health))
    assert filled.keys() == empty.keys() == values(report(health)).keys()
    for what in ('jitter', 'processing', 'age', 'waiting', 'round trip'):
        assert {empty[f'{what} {which} [ms]'] for which in ('p50', 'p99', 'max')} == {'nan'}
        p50, p99, largest = (float(filled[f'{what} {w} [ms]']) for w in ('p50', 'p99', 'max'))
        assert 0 <= p50 <= p99 <= largest
    assert filled['age p50 [ms]'] == filled['age max [ms]'] == '2.000'
    assert filled['processing p50 [ms]'] == '4.000'
    assert float(filled['peak memory [MiB]']) > 1


def test_nothing_is_measured_across_a_pause():
    health = Health()
    health.sent()
    health.round_trips.sent(1)
    health.restart()
    health.sent()
    health.round_trips.answered(1)
    assert values(report(health))['jitter max [ms]'] == 'nan'
    assert values(report(health))['round trip max [ms]'] == 'nan'
