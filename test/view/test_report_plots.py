"""Curves keep their extremes, and figures are those that Plotly takes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from dpc_ros.bag import measure_timing
from dpc_ros.bag.report import converge
from dpc_ros.view.report_plots import LARGEST_CURVE, panels, shown_samples

SAMPLE = Path(__file__).parents[2] / 'bags' / 'demo_1s'
VALUES = st.one_of(st.floats(-1e3, 1e3), st.just(np.nan))


@given(st.integers(1, 300).flatmap(lambda k: arrays(float, k, elements=VALUES)), st.integers(4, 40))
def test_the_samples_shown_keep_both_ends_and_all_extremes(values, largest):
    shown = shown_samples(values, largest)
    assert len(shown) <= max(largest, 4)
    assert shown[0] == 0
    assert shown[-1] == len(values) - 1
    assert (np.diff(shown) > 0).all()
    if np.isfinite(values).any():
        assert np.nanmin(values[shown]) == np.nanmin(values)
        assert np.nanmax(values[shown]) == np.nanmax(values)


def test_no_more_points_than_a_curve_may_have_and_no_fewer_than_there_are():
    assert len(shown_samples(np.zeros(LARGEST_CURVE))) == LARGEST_CURVE
    assert len(shown_samples(np.sin(np.arange(10.0**5)))) <= LARGEST_CURVE


@pytest.fixture(scope='module')
def convergence():
    return converge(SAMPLE)[0]


def test_plotly_takes_every_figure(convergence):
    from plotly.graph_objects import Figure

    timing = measure_timing(convergence.run)
    lost = {'configuration': np.arange(201)}
    shown = panels(convergence, replace(timing, lost=lost))
    keys = ['nmse', 'latent', 'latent_error', 'force', 'energy', 'timing', 'losses']
    assert [panel.key for panel in shown] == keys
    for panel in shown:
        figure = Figure(panel.figure)
        assert figure.data
        assert panel.caption


def test_a_log_that_lost_nothing_has_no_plot_of_it(convergence):
    shown = panels(convergence, measure_timing(convergence.run))
    assert 'losses' not in {panel.key for panel in shown}
