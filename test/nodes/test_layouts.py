"""Layouts for Foxglove, PlotJuggler and RViz: what they show is there to be shown."""

import json
import re
from xml.etree import ElementTree

import pytest
import yaml
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, ReliabilityPolicy
from sensor_msgs.msg import JointState

from dpc_ros.nodes.health import DIAGNOSTICS, Health
from dpc_ros.nodes.launch_plan import NODES
from dpc_ros.nodes.marker_scene import NAMESPACES
from dpc_ros.nodes.markers_node import MARKERS
from dpc_ros.nodes.message_definition import find_message_class
from dpc_ros.nodes.messages import latent_names
from dpc_ros.nodes.topics import TOPICS
from dpc_ros.parameters import declarations
from dpc_ros.resources import config_path

FOLDER = config_path('layouts')
TYPES = {
    **{f'/{topic}': entry.message_type for topic, entry in TOPICS.items()},
    '/markers': MARKERS.message_type,
    DIAGNOSTICS: DiagnosticArray,
}
PANELS = {'3D', 'Plot', 'StateTransitions', 'DiagnosticSummary'}
FRAME = declarations('markers')['frame'].default
READINGS = {
    pair.key: pair.value for pair in Health().report('node', '/node', 'active').values
}  # of every node
NUMBERS = {'double', 'float', 'octet', 'string'}  # Foxglove plots a text that is a number, too
# Of Foxglove's message paths: a field, an element or a slice, a condition on each element.
TOKEN = re.compile(r'\.(\w+)|\[(\d+|:)\]|\{(\w+)=="([^"]*)"\}')


def field_type(message_class, name):
    """Return the type of a field's elements, and whether it is a sequence."""
    declared = message_class.get_fields_and_field_types()[name]
    element = re.fullmatch(r'sequence<(.*)>', declared)
    return (element[1], True) if element else (declared, False)


def class_of(element):
    package, name = element.split('/')
    return find_message_class(f'{package}/msg/{name}')


def follow(path):
    """Follow a message path; return its topic, the type that it leads to, and its conditions."""
    topic, rest = re.fullmatch(r'(/\w+)(.*)', path).groups()
    known, element, is_sequence, conditions = TYPES[topic], '', False, {}
    place = 0
    while place < len(rest):
        token = TOKEN.match(rest, place)
        assert token, f'{path}: {rest[place:]}'
        field, index, condition, value = token.groups()
        if field:
            assert not is_sequence, path
            known = class_of(element) if element else known
            element, is_sequence = field_type(known, field)
        elif index:
            assert is_sequence, path
            is_sequence = False
        else:
            assert condition in class_of(element).get_fields_and_field_types(), path
            conditions[condition] = value
        place = token.end()
    assert not is_sequence, path
    return topic, element, conditions


@pytest.fixture(scope='module')
def foxglove():
    return json.loads((FOLDER / 'foxglove.json').read_text())


def test_foxglove_lays_out_every_panel_once(foxglove):
    def leaves(node):
        if isinstance(node, str):
            return [node]
        assert node['direction'] in ('row', 'column')
        assert 0 < node['splitPercentage'] < 100
        return leaves(node['first']) + leaves(node['second'])

    assert sorted(leaves(foxglove['layout'])) == sorted(foxglove['configById'])
    assert {panel.partition('!')[0] for panel in foxglove['configById']} == PANELS


def test_foxglove_plots_what_the_messages_have(foxglove, paper_2):
    panels = foxglove['configById'].values()
    series = [entry for panel in panels for entry in panel.get('paths', ())]
    assert series
    for entry in series:
        topic, element, conditions = follow(entry['value'])
        assert element in NUMBERS, entry
        if topic == DIAGNOSTICS:
            assert conditions['name'] in NODES
            assert conditions.get('key', 'rate [Hz]') in READINGS
        if topic == '/configuration' and ':' not in entry['value']:
            index = int(re.search(r'\[(\d+)\]', entry['value'])[1])
            assert paper_2.coordinate_names[index] == entry['label']
    for panel in panels:
        assert panel.get('topicToRender', DIAGNOSTICS) == DIAGNOSTICS
        assert all(TYPES[topic] is MARKERS.message_type for topic in panel.get('topics', ()))


def test_foxglove_looks_at_the_frame_of_the_markers(foxglove):
    (scene,) = (panel for panel in foxglove['configById'].values() if 'cameraState' in panel)
    assert scene['followTf'] == FRAME
    assert list(scene['topics']) == ['/markers']


def test_plotjuggler_plots_series_that_it_makes_of_our_messages(paper_2):
    """It names them by topic and field, coordinates by their names, readings by their nodes."""
    root = ElementTree.parse(FOLDER / 'plotjuggler.xml').getroot()
    made = {snippet.get('name') for snippet in root.iter('snippet')}
    sources = [each.text for each in root.iter('linked_source')]
    sources += [each.text for every in root.iter('additional_sources') for each in every]
    names = {*latent_names(5), *paper_2.coordinate_names}
    curves = [curve.get('name') for curve in root.iter('curve')]
    assert made <= {*curves}
    for curve in {*curves, *sources} - made:
        _, topic, *fields = curve.split('/')
        kind = TYPES[f'/{topic}']
        if kind is JointState:
            assert '/'.join(fields[:-1]) in names
            assert fields[-1] in ('position', 'velocity')
        elif kind is DiagnosticArray:
            nothing, node, same, reading = fields  # `hardware_id` begins with a slash
            assert (nothing, node in NODES, same) == ('', True, node)
            assert reading in READINGS
        else:
            assert kind is WrenchStamped
            assert follow(f'/{topic}.{".".join(fields)}')[1] in NUMBERS
    for splitter in root.iter('DockSplitter'):
        sizes = [float(size) for size in splitter.get('sizes').split(';')]
        assert len(sizes) == int(splitter.get('count')) == len(splitter)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-5)


def test_rviz_hears_the_markers_in_their_frame_without_a_transform():
    content = yaml.safe_load((FOLDER / 'dpc_ros.rviz').read_text())['Visualization Manager']
    assert content['Global Options']['Fixed Frame'] == FRAME
    displays = {display['Class']: display for display in content['Displays']}
    markers = displays['rviz_default_plugins/MarkerArray']
    assert markers['Enabled']
    assert set(markers['Namespaces']) == {*NAMESPACES}
    topic = markers['Topic']
    assert TYPES[topic['Value']] is MARKERS.message_type
    assert topic['Reliability Policy'] == 'Reliable'
    assert MARKERS.qos.reliability == ReliabilityPolicy.RELIABLE
    assert topic['Durability Policy'] == 'Volatile'
    assert MARKERS.qos.durability == DurabilityPolicy.VOLATILE
    assert displays['rviz_default_plugins/Grid']['Reference Frame'] == '<Fixed Frame>'
    assert content['Views']['Current']['Class'] == 'rviz_default_plugins/TopDownOrtho'
