"""What a node begins to reject is told once, not with each report."""

import pytest

from dpc_ros.nodes.refusals import Refusals
from dpc_ros.nodes.reports import Report


@pytest.fixture
def newest():
    """Return a function: how often a controller has rejected something, by reason → what is new."""
    refusals = Refusals('target', 'parameters')

    def newest(process='1', **counts):
        values = {f'rejected: {reason}': str(count) for reason, count in counts.items()}
        return refusals.newest(
            Report('/controller', 0.0, {'process id': process, 'host': 'lab', **values})
        )

    return newest


def test_a_reason_is_told_when_it_is_first_there_and_not_while_it_stays(newest):
    assert newest() == ''
    assert newest(**{'target: too far': 1}) == 'target: too far'
    assert newest(**{'target: too far': 1}) == ''


def test_what_was_rejected_before_the_first_report_is_not_told(newest):
    assert newest(**{'target: too far': 3}) == ''
    assert newest(**{'target: too far': 4}) == 'target: too far'


def test_what_comes_again_and_again_is_told_once_until_it_has_stopped(newest):
    newest()
    told = [newest(**{'target: too far': count}) for count in range(1, 6)]
    assert told == ['target: too far', '', '', '', '']
    assert newest(**{'target: too far': 5}) == ''
    assert newest(**{'target: too far': 6}) == 'target: too far'


def test_another_reason_is_told_while_the_first_comes_again(newest):
    newest()
    newest(**{'target: too far': 1})
    both = {'target: too far': 2, 'parameters: no solution': 1}
    assert newest(**both) == 'parameters: no solution'


def test_of_several_new_ones_only_the_first_is_told(newest):
    newest()
    both = {'target: too far': 1, 'parameters: no solution': 1}
    assert newest(**both) == 'target: too far'
    assert newest(**both) == ''


def test_a_node_that_was_started_anew_counts_anew(newest):
    newest(**{'target: too far': 1})
    assert newest('2', **{'target: too far': 1}) == 'target: too far'


def test_messages_on_other_topics_are_passed_over(newest):
    newest()
    assert newest(**{'latent_state: no number': 1, 'other reasons': 7}) == ''
