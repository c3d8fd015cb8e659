"""`metadata.yaml`, the table of contents of a rosbag2 bag, in format version 9 (ROS 2 Jazzy)."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dpc_ros.bag.topic import QosProfile, qos_content
from dpc_ros.files import replacing

FILE_NAME = 'metadata.yaml'
FORMAT_VERSION = 9
PARAMETERS_RECORD = 'dpc_ros.parameters'  # of the record that keeps the nodes' parameter file
MACHINE_RECORD = 'dpc_ros.machine'  # of what the results depend on, by name
RECORD_NAME = 'rosbag2'  # of the record in the MCAP file that repeats the content


@dataclass(frozen=True)
class FileSpan:
    """What `metadata.yaml` says of one MCAP file.

    Attributes:
        name: of the file, relative to the bag's folder.
        message_count: of all topics.
        start_ns: log time of its first message, 0 where there is none [ns since the epoch].
        end_ns: log time of its last message, likewise.
    """

    name: str
    message_count: int
    start_ns: int
    end_ns: int


def bag_content(
    files: Sequence[FileSpan], topics: Sequence[tuple[dict[str, Any], int]], ros_distro: str
) -> dict[str, Any]:
    """Return what rosbag2 wants to know of a bag.

    Args:
        files: in the order of the recording.
        topics: `topic_content` of each topic, and its number of messages.
        ros_distro: name of the ROS distribution that recorded it, empty where it is not known.
    """
    filled = [file for file in files if file.message_count]
    start = min((file.start_ns for file in filled), default=0)
    end = max((file.end_ns for file in filled), default=0)
    return {
        'version': FORMAT_VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(file.message_count for file in files),
        'topics_with_message_count': [
            {'topic_metadata': topic, 'message_count': count} for topic, count in topics
        ],
        # MCAP compresses its chunks itself: to rosbag2 such a bag is not compressed.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [
            {
                'path': file.name,
                'starting_time': {'nanoseconds_since_epoch': file.start_ns},
                'duration': {'nanoseconds': file.end_ns - file.start_ns},
                'message_count': file.message_count,
            }
            for file in files
        ],
        'custom_data': None,
        'ros_distro': ros_distro,
    }


def topic_content(
    name: str, type_name: str, offered_qos_profiles: Iterable[QosProfile], type_hash: str
) -> dict[str, Any]:
    """Return what rosbag2 wants to know of a topic."""
    return {
        'name': name,
        'type': type_name,
        'serialization_format': 'cdr',
        'offered_qos_profiles': [qos_content(profile) for profile in offered_qos_profiles],
        'type_description_hash': type_hash,
    }


def bag_text(content: dict[str, Any]) -> str:
    """Return the content of a bag as the YAML that stands in the MCAP file itself."""
    return yaml.safe_dump(content, sort_keys=False)


def file_names(folder: Path) -> list[str]:
    """Return the names of the MCAP files that `metadata.yaml` lists, in the order of the recording.

    Raises:
        OSError: there is no such file.
        ValueError: it is not that of a bag.
    """
    try:
        content = yaml.safe_load((folder / FILE_NAME).read_text())
    # A cut off or overwritten file is no YAML, or one of another shape.
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError('no YAML') from error
    information = content.get('rosbag2_bagfile_information') if isinstance(content, dict) else None
    names = information.get('relative_file_paths') if isinstance(information, dict) else None
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise ValueError('no list of relative_file_paths')
    return names


def write_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Write `metadata.yaml` whole or not at all."""
    text = yaml.safe_dump({'rosbag2_bagfile_information': content}, sort_keys=False)
    with replacing(folder / FILE_NAME) as partial, partial.open('w') as stream:
        stream.write(text)
        stream.flush()
        os.fsync(stream.fileno())
