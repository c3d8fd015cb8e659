"""Losses are seen by the numbers of the messages that came."""

from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.nodes.health import SequenceCounter


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
