"""The definitions that are made of message classes describe the bytes that rclpy writes."""

import re

import pytest
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Quaternion, Vector3, WrenchStamped
from mcap.records import Schema
from mcap_ros2.decoder import DecoderFactory
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import JointState
from shape_msgs.msg import SolidPrimitive
from std_msgs.msg import ColorRGBA, Empty, Header
from visualization_msgs.msg import Marker, MarkerArray

from dpc_ros.nodes.message_definition import (
    check_definition,
    find_message_class,
    message_definition,
    message_type_name,
)

HEADER = Header(stamp=Time(sec=12, nanosec=345_000_000), frame_id='paper_2@0123')

MESSAGES = [
    # No array is empty: `serialize_message` pads empty ones, which rosbags takes for an error.
    JointState(
        header=HEADER,
        name=['xi_0', 'ξ_1'],
        position=[0.5, -1e-300],
        velocity=[float('inf'), 3.0],
        effort=[0.0, 7.0],
    ),
    WrenchStamped(header=HEADER),
    DiagnosticArray(
        header=HEADER,
        status=[
            DiagnosticStatus(
                level=DiagnosticStatus.WARN,
                name='encoder',
                message='late',
                values=[KeyValue(key='rate', value='200 Hz'), KeyValue()],
            ),
            DiagnosticStatus(),
        ],
    ),
    MarkerArray(
        markers=[
            Marker(
                header=HEADER,
                ns='body',
                id=-3,
                type=Marker.LINE_LIST,
                scale=Vector3(x=0.01),
                color=ColorRGBA(r=0.25, a=1.0),
                lifetime=Duration(sec=1),
                frame_locked=True,
                points=[Point(x=float(i), y=2.0) for i in range(4)],
                colors=[ColorRGBA(g=0.5)] * 4,
            ),
            Marker(),
        ]
    ),
    Clock(clock=Time(sec=2**31 - 1, nanosec=999_999_999)),
    Empty(),
]
MESSAGES[1].wrench.force = Vector3(x=1.5, y=-2.5)

message = pytest.mark.parametrize('message', MESSAGES, ids=lambda m: type(m).__name__)


def like(message, decoded):
    """Give the decoded values of the fields of a message as dictionaries, lists and scalars."""
    if hasattr(message, 'get_fields_and_field_types'):
        return {
            name: like(getattr(message, name), getattr(decoded, name))
            for name in message.get_fields_and_field_types()
        }
    if isinstance(message, bytes) and isinstance(decoded, int):
        return bytes([decoded])
    if isinstance(message, (str, bytes)) or not hasattr(message, '__len__'):
        return decoded
    return [like(*pair) for pair in zip(message, decoded, strict=True)]


@message
def test_mcap_decodes_what_rclpy_serialises(message):
    schema = Schema(
        id=1,
        name=message_type_name(type(message)),
        encoding='ros2msg',
        data=message_definition(type(message)).encode(),
    )
    decode = DecoderFactory().decoder_for('cdr', schema)
    decoded = decode(serialize_message(message))
    assert like(message, decoded) == like(message, message)


@message
def test_rosbags_decodes_what_rclpy_serialises(message):
    name = message_type_name(type(message))
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(message_definition(type(message)), name))
    decoded = store.deserialize_cdr(serialize_message(message), name)
    assert like(message, decoded) == like(message, message)


@message
def test_fields_equal_the_published_definitions(message):
    if isinstance(message, Empty):
        pytest.skip('rosbags names the byte that stands for no fields')
    types = get_types_from_msg(message_definition(type(message)), message_type_name(type(message)))
    published = get_typestore(Stores.ROS2_JAZZY).fielddefs
    assert {name: fields for name, (_, fields) in types.items()} == {
        name: published[name][1] for name in types
    }


def test_type_name():
    assert message_type_name(JointState) == 'sensor_msgs/msg/JointState'


@pytest.mark.parametrize('message_class', [JointState, DiagnosticArray, Empty])
def test_a_class_is_found_by_its_name(message_class):
    assert find_message_class(message_type_name(message_class)) is message_class


@pytest.mark.parametrize(
    ('name', 'complaint'),
    [
        ('nowhere_msgs/msg/Thing', "installed package, but No module named 'nowhere_msgs'"),
        ('std_msgs/msg/Nothing', 'Nothing'),
        ('std_srvs/srv/Trigger_Event', "a message type.*got 'std_srvs/srv/Trigger_Event'"),
    ],
)
def test_a_name_without_a_class_is_refused(name, complaint):
    with pytest.raises(ValueError, match=complaint):
        find_message_class(name)


def test_text_of_a_definition_with_dependencies():
    separator = '=' * 80
    assert message_definition(DiagnosticArray) == (
        'std_msgs/Header header\n'
        'diagnostic_msgs/DiagnosticStatus[] status\n'
        f'{separator}\n'
        'MSG: std_msgs/Header\n'
        'builtin_interfaces/Time stamp\n'
        'string frame_id\n'
        f'{separator}\n'
        'MSG: diagnostic_msgs/DiagnosticStatus\n'
        'byte OK=0\n'
        'byte WARN=1\n'
        'byte ERROR=2\n'
        'byte STALE=3\n'
        'byte level\n'
        'string name\n'
        'string message\n'
        'string hardware_id\n'
        'diagnostic_msgs/KeyValue[] values\n'
        f'{separator}\n'
        'MSG: builtin_interfaces/Time\n'
        'int32 sec\n'
        'uint32 nanosec\n'
        f'{separator}\n'
        'MSG: diagnostic_msgs/KeyValue\n'
        'string key\n'
        'string value\n'
    )


def test_each_dependency_comes_once():
    headings = re.findall('^MSG: (.*)$', message_definition(MarkerArray), re.MULTILINE)
    assert headings[0] == 'visualization_msgs/Marker'
    assert len(headings) == len(set(headings))
    assert {'std_msgs/Header', 'geometry_msgs/Point', 'builtin_interfaces/Time'} < set(headings)


def with_fields(**fields):
    """Make a class that looks like a generated message class with these fields."""
    metaclass = type('Metaclass_Made', (type,), {'_Metaclass_Made__constants': {}})
    return metaclass(
        'Made',
        (),
        {
            '__module__': 'made_msgs.msg._made',
            'get_fields_and_field_types': classmethod(lambda cls: fields),
        },
    )


@pytest.mark.parametrize(
    ('idl_type', 'msg_type'),
    [
        ('boolean', 'bool'),
        ('octet', 'byte'),
        ('float', 'float32'),
        ('double', 'float64'),
        ('uint64', 'uint64'),
        ('wstring', 'wstring'),
        ('string<10>', 'string<=10'),
        ('sequence<double>', 'float64[]'),
        ('sequence<double, 3>', 'float64[<=3]'),
        ('double[36]', 'float64[36]'),
        ('sequence<string<10>, 5>', 'string<=10[<=5]'),
        ('string<10>[4]', 'string<=10[4]'),
    ],
)
def test_field_types(idl_type, msg_type):
    made = with_fields(value=idl_type)
    assert message_definition(made) == f'{msg_type} value\n'
    assert message_type_name(made) == 'made_msgs/msg/Made'


def test_unknown_field_type_is_refused():
    with pytest.raises(ValueError, match='map<string, double>'):
        message_definition(with_fields(value='map<string, double>'))


@pytest.mark.parametrize('message_class', [ParameterDescriptor, SolidPrimitive, Quaternion])
def test_constants_and_bounds_parse(message_class):
    name = message_type_name(message_class)
    constants, fields = get_types_from_msg(message_definition(message_class), name)[name]
    for constant, _, value in constants:
        assert getattr(message_class, constant) == value
    assert [field for field, _ in fields] == list(message_class.get_fields_and_field_types())


@message
def test_a_type_is_found_by_its_name_and_fits_every_text_of_its_definition(message):
    name = message_type_name(type(message))
    found = find_message_class(name)
    assert found is type(message)
    store = get_typestore(Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(name, ros_version=2)
    check_definition(found, text)
    check_definition(found, message_definition(found))
    commented = re.sub(r'^(?!=|MSG)(.*)$', r'  \1  # as it was', text, flags=re.M)
    check_definition(found, f'# of old\nuint8 LIMIT=3\n{commented}')


def test_a_definition_with_other_fields_is_refused():
    text = message_definition(WrenchStamped)
    for changed in (
        text.replace('float64 z', 'float32 z'),
        text.replace('wrench', 'load'),
        text.replace('float64 x\nfloat64 y', 'float64 y\nfloat64 x'),
        text.replace('nanosec', 'microsec'),
    ):
        with pytest.raises(ValueError, match=r'recorded with the fields .* installed'):
            check_definition(WrenchStamped, changed)


@pytest.mark.parametrize('name', ['nowhere_msgs/msg/Sound', 'std_msgs/msg/Sound', 'sound', 'a/b'])
def test_a_type_that_is_not_there_is_said(name):
    with pytest.raises(ValueError, match=name):
        find_message_class(name)
