"""`metadata.yaml`, the table of contents of a rosbag2 bag, in format version 9 (ROS 2 Jazzy)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from dpc_ros.bag.topic import Topic, qos_content
from dpc_ros.files import replacing

FILE_NAME = 'metadata.yaml'
FORMAT_VERSION = 9
PARAMETERS_RECORD = 'dpc_ros.parameters'  # of the record that keeps the nodes' parameter file
RECORD_NAME = 'rosbag2'  # of the record in the MCAP file that repeats the content


def bag_content(
    file_name: str,
    counts: Mapping[Topic, int],
    starting_time_ns: int,
    duration_ns: int,
    ros_distro: str,
) -> dict[str, Any]:
    """Return what rosbag2 wants to know of a bag of one MCAP file.

    Args:
        file_name: of the MCAP file, relative to the bag's folder.
        counts: messages of each topic.
        starting_time_ns: log time of the first message [ns since the epoch].
        duration_ns: from the first to the last message [ns].
        ros_distro: name of the ROS distribution that recorded it.
    """
    message_count = sum(counts.values())
    return {
        'version': FORMAT_VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': duration_ns},
        'starting_time': {'nanoseconds_since_epoch': starting_time_ns},
        'message_count': message_count,
        'topics_with_message_count': [
            {'topic_metadata': _topic_content(topic), 'message_count': count}
            for topic, count in counts.items()
        ],
        # MCAP compresses its chunks itself: to rosbag2 such a bag is not compressed.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file_name],
        'files': [
            {
                'path': file_name,
                'starting_time': {'nanoseconds_since_epoch': starting_time_ns},
                'duration': {'nanoseconds': duration_ns},
                'message_count': message_count,
            }
        ],
        'custom_data': None,
        'ros_distro': ros_distro,
    }


def bag_text(content: dict[str, Any]) -> str:
    """Return the content of a bag as the YAML that stands in the MCAP file itself."""
    return yaml.safe_dump(content, sort_keys=False)


def write_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Write `metadata.yaml` whole or not at all."""
    text = yaml.safe_dump({'rosbag2_bagfile_information': content}, sort_keys=False)
    with replacing(folder / FILE_NAME) as partial, partial.open('w') as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())


def _topic_content(topic: Topic) -> dict[str, Any]:
    return {
        'name': topic.name,
        'type': topic.type_name,
        'serialization_format': 'cdr',
        'offered_qos_profiles': [qos_content(profile) for profile in topic.offered_qos_profiles],
        'type_description_hash': topic.type_hash,
    }
