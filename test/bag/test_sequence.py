"""Numbers of one publisher's messages tell what was lost, whatever order they were recorded in."""

from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.bag.sequence import Sequence


def counted(numbers):
    """Return a sequence of messages that were published in the order of their numbers."""
    sequence = Sequence()
    for number in numbers:
        sequence.add(number, 1000 * number)
    return sequence


@settings(max_examples=200)
@given(st.lists(st.integers(2, 60), unique=True))
def test_what_is_missing_is_lost_whatever_the_order(others):
    recorded = [1, *others]
    missing = set(range(1, max(recorded) + 1)) - set(recorded)
    assert counted(recorded).lost == len(missing)


def test_a_publisher_that_was_started_anew_has_lost_nothing():
    sequence = counted([1, 2, 5])
    for number in (1, 2, 3, 4):
        sequence.add(number, 10_000 + number)
    assert sequence.lost == 2


def test_without_numbers_nothing_is_known():
    sequence = Sequence()
    for time in range(5):
        sequence.add(0, time)
    assert not sequence.is_numbered
    assert sequence.lost == 0
