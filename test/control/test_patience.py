"""Waiting counts while somebody looks, not while the process stands still."""

import pytest

from dpc_ros.control import Patience


def test_the_time_of_a_process_that_stood_still_does_not_count():
    patience = Patience(0.2)
    patience.begin(100.0)
    assert patience.look(100.2) == pytest.approx(0.2)
    assert patience.look(100.5) == pytest.approx(0.5)  # somewhat late
    assert patience.look(3600.0) == pytest.approx(0.9)  # two looks' worth
    assert patience.look(3600.2) == pytest.approx(1.1)
    patience.begin(3600.2)
    assert patience.look(3600.3) == pytest.approx(0.1)
