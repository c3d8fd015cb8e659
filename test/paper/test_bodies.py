"""The figure of many bodies."""

from dpc_ros.paper import bodies

ROW = {'cores': 0.5, 'round_trip_p50_ms': 2.0, 'round_trip_p99_ms': 3.0, 'discovery_s': 0.2}
ROWS = [{'bodies': 4.0, **ROW}, {'fault': 'another one'}, {'bodies': 1, **ROW}]


def test_rows_of_bodies_come_by_their_number():
    assert [row['bodies'] for row in bodies.of_bodies(ROWS)] == [1, 4.0]


def test_the_figure_is_drawn_of_what_else_the_file_may_have(tmp_path):
    bodies.draw(ROWS, tmp_path / 'bodies.png')
    assert (tmp_path / 'bodies.png').read_bytes().startswith(b'\x89PNG')
