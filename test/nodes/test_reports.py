"""What `dpc top` makes of the nodes' reports: who is shown, who is silent."""

from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from hypothesis import given
from hypothesis import strategies as st

from dpc_ros.nodes.health import Health
from dpc_ros.nodes.reports import LONGEST_SILENCE, Reports
from dpc_ros.nodes.top_table import table

LATE = LONGEST_SILENCE + 1


def status(node='/encoder', process=1, message='active', level=DiagnosticStatus.OK, host='here'):
    made = Health().report(node.rpartition('/')[2], node, 'active')
    made.message, made.level = message, level
    own = {'process id': str(process), 'host': host}
    made.values = [pair for pair in made.values if pair.key not in own]
    made.values += [KeyValue(key=key, value=value) for key, value in own.items()]
    return made


def rows(reports, now):
    """Return name and state of each row of the table."""
    lines = table(reports.newest(now), now).partition('\n\n')[0].splitlines()[2:]
    return [tuple(line.split()[:2]) for line in lines]


def test_a_node_that_does_not_speak_any_more_is_silent():
    reports = Reports()
    assert reports.take(status('/encoder'), 0)
    assert reports.take(status('/simulator'), LATE)
    assert rows(reports, 0) == [('/encoder', 'active'), ('/simulator', 'active')]
    assert rows(reports, LATE) == [('/encoder', 'silent'), ('/simulator', 'active')]


def test_a_node_that_never_spoke_is_silent_in_time():
    reports = Reports()
    reports.see(['/encoder'], 0)
    reports.see(['/encoder', '/player'], LATE)
    assert rows(reports, LATE) == [('/encoder', 'silent'), ('/player', '–')]
    reports.see([], LATE)
    assert not reports.newest(LATE)


def test_two_processes_of_one_name_are_both_shown_until_one_replaces_the_other():
    reports = Reports()
    for process in (1, 2):
        reports.take(status(process=process), 0)
    assert rows(reports, 0) == [('/encoder', 'active')] * 2
    assert rows(reports, LATE) == [('/encoder', 'silent')] * 2
    reports.take(status(process=3), LATE)
    assert rows(reports, LATE) == [('/encoder', 'active')]


def test_hosts_are_shown_where_there_are_several():
    reports = Reports()
    reports.take(status('/encoder'), 0)
    reports.take(status('/controller'), 0)
    reports.see(['/player'], 0)
    assert 'here' not in table(reports.newest(0), 0)
    reports.take(status('/simulator', host='there'), 0)
    title, _, *shown = table(reports.newest(0), 0).splitlines()
    assert title.split()[-1] == 'host'
    assert [line.split()[-1] for line in shown] == ['here', 'here', '–', 'there']


def test_only_the_nodes_of_the_namespace_are_shown():
    reports = Reports('body')
    assert not reports.take(status('/encoder'), 0)
    assert not reports.take(status('/body_2/encoder'), 0)
    assert reports.take(status('/body/encoder'), 0)
    reports.see(['/encoder', '/body_2/encoder', '/body/player'], 0)
    assert rows(reports, LATE) == [('/body/encoder', 'silent'), ('/body/player', 'silent')]


def test_nodes_that_report_in_another_way_are_left_out():
    reports = Reports()
    assert not reports.take(DiagnosticStatus(name='camera: frames'), 0)
    reports.see(['/camera'], 0)
    assert not reports.newest(LATE)


@given(letters=st.text(min_size=1, max_size=20))
def test_nothing_that_a_node_says_moves_the_cursor(letters):
    reports = Reports()
    reports.take(status('/another'), 0)
    reports.take(status(f'/{letters}', 1, letters, DiagnosticStatus.WARN, host=letters), 0)
    shown = table(reports.newest(0), 0)
    assert shown.replace('\n', '').isprintable()
    assert len(shown.split('\n')) == 6


def test_many_names_fill_no_memory():
    reports = Reports()
    for number in range(1000):
        reports.take(status(f'/node_{number}'), number)
        reports.take(DiagnosticStatus(name=f'stranger_{number}'), number)
    assert len(reports.newest(1000)) == 100
    assert reports.newest(1000)[-1].node == '/node_999'
