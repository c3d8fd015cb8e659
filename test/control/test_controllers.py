"""Two controllers of one body are seen as long as both live, and no longer."""

from hypothesis import given, settings
from hypothesis import strategies as st

from dpc_ros.control import Controllers

TIMEOUT = 0.5  # s


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.sampled_from(['', 'a', 'b', 'c', 'd']), st.floats(0, 0.4)), max_size=12),
    st.floats(0, 1.0),
)
def test_rivals_are_any_two_that_were_heard_of_late(forces, silence):
    controllers, heard, now = Controllers(TIMEOUT), {}, 0.0
    for identifier, pause in forces:
        now += pause
        controllers.hear(identifier, now)
        heard[identifier] = now
    now += silence
    living = {each for each, time in heard.items() if now - time <= TIMEOUT}
    rivals = controllers.rivals(now)
    assert set(rivals) <= living
    assert len(rivals) == (2 if len(living) > 1 else 0)
    assert bool(controllers.conflict(now)) == bool(rivals)


def test_a_controller_that_falls_silent_leaves_the_body_to_the_other():
    controllers = Controllers(TIMEOUT)
    controllers.hear('1f3a9c02', 0.0)
    controllers.hear('', 0.25)
    assert controllers.conflict(0.5).endswith('those of one without an id and 1f3a9c02')
    assert controllers.conflict(0.6) == ''
    controllers.timeout = 1.0  # as set while it runs
    assert controllers.rivals(0.6) == ('', '1f3a9c02')


def test_one_controller_is_never_a_conflict():
    controllers = Controllers(TIMEOUT)
    for k in range(100):
        controllers.hear('1f3a9c02', 0.01 * k)
        assert controllers.rivals(0.01 * k) == ()
