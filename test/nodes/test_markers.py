"""Markers say where the body is, bit for bit, and are those that the run is launched with."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message
from visualization_msgs.msg import Marker, MarkerArray

from dpc_ros.nodes.launch_plan import COMPANIONS, make_plan
from dpc_ros.nodes.marker_scene import (
    BODY,
    FIXED,
    FORCE,
    NAMESPACES,
    RECONSTRUCTION,
    TARGET,
    MarkerScene,
)
from dpc_ros.nodes.messages import from_stamp
from dpc_ros.parameters import declarations
from dpc_ros.resources import config_path
from dpc_ros.view import strain_colours

SPRINGS = (BODY, RECONSTRUCTION, TARGET)
LARGEST_STRAIN = 0.3


def drawn(scene):
    """Return the markers by namespace, as a viewer reads them."""
    markers = deserialize_message(scene.message(), MarkerArray).markers
    assert [marker.ns for marker in markers] == list(NAMESPACES)
    return {marker.ns: marker for marker in markers}


def points_of(marker):
    return np.array([(point.x, point.y, point.z) for point in marker.points])


@pytest.fixture
def scene(small_network):
    return MarkerScene(small_network, 'world', LARGEST_STRAIN)


def test_at_first_only_what_holds_the_body_is_drawn(scene, small_network):
    markers = drawn(scene)
    shown = [name for name, marker in markers.items() if marker.action == Marker.ADD]
    assert shown == [FIXED]
    expected = small_network.rest_position[small_network.fixed]
    np.testing.assert_array_equal(points_of(markers[FIXED])[:, :2], expected)
    assert {marker.header.frame_id for marker in markers.values()} == {'world'}
    assert all(marker.action in (Marker.ADD, Marker.DELETE) for marker in markers.values())


@given(seed=st.integers(0, 10_000), stamp=st.integers(0, 2**31 * 10**9 - 1))
def test_springs_end_at_the_masses_that_they_join(random_network, random_state, seed, stamp):
    network = random_network(seed)
    scene = MarkerScene(network, 'world', LARGEST_STRAIN)
    configurations = {name: random_state(seed + k, network)[0] for k, name in enumerate(SPRINGS)}
    for name, configuration in configurations.items():
        scene.show_springs(name, configuration, stamp)
    markers = drawn(scene)
    for name, configuration in configurations.items():
        marker, ends = markers[name], network.positions(configuration)[network.springs]
        assert (marker.type, marker.action) == (Marker.LINE_LIST, Marker.ADD)
        assert from_stamp(marker.header.stamp) == stamp
        np.testing.assert_array_equal(points_of(marker)[:, :2], ends.reshape(-1, 2))
    strain = network.strains(configurations[BODY])
    expected = np.repeat(strain_colours(strain, LARGEST_STRAIN), 2, axis=0)
    colours = np.array([(each.r, each.g, each.b, each.a) for each in markers[BODY].colors])
    np.testing.assert_array_equal(np.rint(255 * colours[:, :3]), expected)
    assert (colours[:, 3] == 1.0).all()
    assert not markers[TARGET].colors
    assert markers[TARGET].color.a < markers[RECONSTRUCTION].color.a < 1.0  # pale


def test_a_force_is_an_arrow_until_it_is_hidden(scene):
    origin, arrow = np.array([0.1, -0.3]), np.array([0.7, 0.05])
    scene.show_force(origin, arrow, 7)
    marker = drawn(scene)[FORCE]
    assert (marker.type, marker.action) == (Marker.ARROW, Marker.ADD)
    np.testing.assert_array_equal(points_of(marker)[:, :2], [origin, origin + arrow])
    scene.hide(FORCE)
    assert drawn(scene)[FORCE].action == Marker.DELETE


def test_companions_draw_the_network_of_the_run_and_nobody_waits_for_them(tmp_path):
    given_network = {
        'simulator': {'network': 'paper_1'},
        'encoder': {'checkpoint': 'paper_1_extended_m5'},
    }
    plan = make_plan(
        config_path('demo.yaml'), given_network, tmp_path / 'run', companions=COMPANIONS
    )
    alone = make_plan(config_path('demo.yaml'), given_network, tmp_path / 'run')
    assert plan.companions == COMPANIONS
    for kind in COMPANIONS:
        assert plan.parameters[kind]['network'] == 'paper_1'
        assert plan.parameters[kind]['checkpoint'] == 'paper_1_extended_m5'
    assert {node: plan.parameters[node] for node in alone.nodes} == alone.parameters
    own = {'markers': {'network': 'paper_3'}}
    plan = make_plan(config_path('demo.yaml'), own, tmp_path / 'run', companions=['markers'])
    assert plan.parameters['markers']['network'] == 'paper_3'


def test_markers_are_recorded_only_where_they_are_asked_for(tmp_path):
    assert 'markers' not in declarations('recorder')['topics'].default
    assert not make_plan(config_path('demo.yaml'), {}, tmp_path / 'run').records('markers')
