"""Pictures of networks show every mass and spring where they are, to scale."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.image import imread

from dpc_ros.network import (
    MassSpringNetwork,
    NetworkError,
    draw_figure,
    draw_network,
    draw_springs,
)


@pytest.fixture
def axes():
    figure = Figure()
    FigureCanvasAgg(figure)
    return figure.subplots()


def lines(axes):
    (collection,) = (child for child in axes.get_children() if isinstance(child, LineCollection))
    return np.array(collection.get_segments())


def markers(axes):
    """Return what is drawn as points: the mobile masses, the fixed ones."""
    return [line.get_xydata() for line in axes.lines]


def test_shows_all_springs_and_masses_at_rest(paper_2, axes):
    draw_network(paper_2, axes)
    mobile, fixed = markers(axes)
    np.testing.assert_array_equal(mobile, paper_2.rest_position[paper_2.mobile])
    np.testing.assert_array_equal(fixed, paper_2.rest_position[paper_2.fixed])
    np.testing.assert_array_equal(lines(axes), paper_2.rest_position[paper_2.springs])
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ('x [m]', 'y [m]')
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ['springs (636)', 'mobile masses (200)', 'fixed masses (5)']


def test_springs_alone_lie_where_the_configuration_says(random_network, random_state, axes):
    network = random_network(3)
    q, _ = random_state(3, network)
    draw_springs(network, axes, q, color='red', label='strained')
    position = network.rest_position.copy()
    position[network.mobile] = q.reshape(-1, 2)
    np.testing.assert_array_equal(lines(axes), position[network.springs])
    assert axes.get_legend_handles_labels()[1] == ['strained']
    assert not axes.lines
    with pytest.raises(NetworkError, match='configuration: expected'):
        draw_springs(network, axes, q[:-1])


@given(st.integers(0, 2**32 - 1))
def test_shows_a_configuration_within_its_limits(random_network, random_state, seed):
    axes = Figure().subplots()
    network = random_network(seed)
    q, _ = random_state(seed, network)
    draw_network(network, axes, 10 * q)
    mobile, fixed = markers(axes)
    np.testing.assert_array_equal(mobile.ravel(), 10 * q)
    np.testing.assert_array_equal(fixed, network.rest_position[network.fixed])
    shown = np.concatenate([mobile, fixed])
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert ((shown > [left, bottom]) & (shown < [right, top])).all()


@pytest.mark.parametrize(
    ('label_every', 'expected'),
    [(None, range(0, 205, 10)), (0, []), (100, [0, 100, 200])],
)
def test_some_masses_are_numbered(paper_2, axes, label_every, expected):
    draw_network(paper_2, axes, label_every=label_every, legend=False)
    assert axes.get_legend() is None
    assert [text.get_text() for text in axes.texts] == [str(mass) for mass in expected]
    for text, mass in zip(axes.texts, expected, strict=True):
        np.testing.assert_array_equal(text.xy, paper_2.rest_position[mass])


def test_small_bodies_have_all_masses_numbered(small_network, axes):
    draw_network(small_network, axes)
    assert len(axes.texts) == 15


def test_a_figure_is_a_png_of_the_bodys_shape(paper_2, tmp_path):
    draw_figure(paper_2, tmp_path / 'new' / 'wide.png')
    turned = replace(paper_2, rest_position=paper_2.rest_position[:, ::-1] * [2, 1])
    draw_figure(turned, tmp_path / 'new' / 'flat.png')
    assert sorted(path.name for path in (tmp_path / 'new').iterdir()) == ['flat.png', 'wide.png']
    (height, width, _), (flat_height, flat_width, _) = (
        imread(tmp_path / 'new' / name).shape for name in ('wide.png', 'flat.png')
    )
    assert flat_height / flat_width < height / width


@pytest.mark.parametrize('second', [[0.0, -1.0], [1e-9, 0.0], [0.0, 0.0], [1e5, 0.0]])
def test_bodies_without_width_are_drawn(tmp_path, second):
    pendulum = MassSpringNetwork(
        name='pendulum',
        mass=np.ones(2),
        fixed=np.array([0]),
        rest_position=np.array([[0.0, 0.0], second]),
        springs=np.array([[0, 1]]),
        stiffness=np.ones(1),
        rest_length=np.ones(1),
        damping=np.ones(1),
    )
    draw_figure(pendulum, tmp_path / 'pendulum.png')
    assert imread(tmp_path / 'pendulum.png').std() > 0


@pytest.mark.parametrize('bad', [np.zeros(3), np.zeros((12, 2)), np.full(24, np.nan)])
def test_configurations_of_another_body_are_refused(small_network, axes, tmp_path, bad):
    with pytest.raises(NetworkError, match='configuration: expected 24 finite numbers for grid'):
        draw_network(small_network, axes, bad)
    with pytest.raises(NetworkError, match='configuration: expected 24 finite numbers'):
        draw_figure(small_network, tmp_path / 'x.png', bad)
    assert list(tmp_path.iterdir()) == []


def test_a_picture_needs_no_global_state(small_network, tmp_path):
    import matplotlib.pyplot as plt

    draw_figure(small_network, tmp_path / 'grid.png')
    assert plt.get_fignums() == []


def test_a_place_that_cannot_be_written_is_named(small_network, tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(OSError, match="can't be written"):
        draw_figure(small_network, tmp_path / 'file' / 'grid.png')
