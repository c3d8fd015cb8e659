"""rosbags, dpc_ros and what Foxglove reads with find the same in a log."""

import numpy as np
import pytest

from dpc_ros.bag import BagWriter
from dpc_ros.resources import share_directory


@pytest.fixture
def every_reader(reader_in_node, assert_readers_agree):
    if reader_in_node is None:
        pytest.skip('Node is not installed: logs are read by rosbags and dpc_ros only')
    return assert_readers_agree


def test_the_sample_log(every_reader):
    (bag,) = (path for path in (share_directory() / 'bags').iterdir() if path.is_dir())
    every_reader(bag)


def test_values_that_are_easily_misread(messages, every_reader, tmp_path):
    types = messages.store.types
    layout = types['std_msgs/msg/MultiArrayLayout'](dim=[], data_offset=2**32 - 1)
    odd = np.array([np.nan, -np.inf, -0.0, 5e-324, 2.0**0.5])
    written = [
        types['std_msgs/msg/Float32MultiArray'](layout=layout, data=odd.astype(np.float32)),
        types['std_msgs/msg/Float64MultiArray'](layout=layout, data=odd),
        types['std_msgs/msg/Int64MultiArray'](layout=layout, data=np.array([-(2**63), 2**63 - 1])),
        types['std_msgs/msg/UInt64'](data=2**64 - 1),
        types['std_msgs/msg/Float32'](data=float('nan')),
        types['std_msgs/msg/Float64'](data=float('-inf')),
        types['std_msgs/msg/Bool'](data=True),
        types['std_msgs/msg/String'](data='ξ̇ = J q̇, "quoted"\n'),
        types['std_msgs/msg/ByteMultiArray'](layout=layout, data=np.array([0, 255], np.uint8)),
        types['diagnostic_msgs/msg/DiagnosticStatus'](
            level=1,
            name='encoder',
            message='',
            hardware_id='/encoder',
            values=[types['diagnostic_msgs/msg/KeyValue'](key='rate', value='200')],
        ),
    ]
    with BagWriter(tmp_path / 'run') as bag:
        for number, message in enumerate(written, 1):
            kind = message.__msgtype__
            topic = messages.topic(f'/{kind.rpartition("/")[2].lower()}', kind)
            bag.add_topic(topic)
            cdr = bytes(messages.store.serialize_cdr(message, kind))
            bag.write(topic.name, cdr, number, number, number)
    every_reader(tmp_path / 'run')
