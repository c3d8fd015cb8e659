"""`metadata.yaml`, the table of contents of a rosbag2 bag, in format version 9 (ROS 2 Jazzy)."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dpc_ros.bag.topic import Topic, qos_content
from dpc_ros.files import replacing

FILE_NAME = 'metadata.yaml'
FORMAT_VERSION = 9
# Records of keys and values that a log may hold.
PARAMETERS_RECORD = 'dpc_ros.parameters'  # the parameter file of the run, under `yaml`
NODE_PARAMETERS_RECORD = 'dpc_ros.node_parameters'  # what each node answered, by its name
MODELS_RECORD = 'dpc_ros.models'  # network and checkpoint with digests, by topic
VERSIONS_RECORD = 'dpc_ros.versions'
MACHINE_RECORD = 'dpc_ros.machine'  # what the results depend on, by name
COMMAND_RECORD = 'dpc_ros.command'  # the command lines behind the log
LOSSES_RECORD = 'dpc_ros.losses'  # messages lost up to the end of the file, by topic
RECORD_NAME = 'rosbag2'  # of the record in the MCAP file that repeats the content

_KEY = 'rosbag2_bagfile_information'
# libyaml writes fast, but its reader dies of deeply nested text: never the loader to these.
_DUMPER = getattr(yaml, 'CSafeDumper', yaml.SafeDumper)


@dataclass(frozen=True)
class BagFile:
    """What a bag says of one of its MCAP files.

    Attributes:
        name: of the file, relative to the bag's folder.
        counts: messages of each topic.
        starting_time_ns: log time of the first message [ns since the epoch]; 0 without one.
        duration_ns: from the first to the last message [ns].
    """

    name: str
    counts: Mapping[Topic, int]
    starting_time_ns: int
    duration_ns: int

    @property
    def message_count(self) -> int:
        """Number of messages of all topics."""
        return sum(self.counts.values())


def bag_content(files: Sequence[BagFile], ros_distro: str) -> dict[str, Any]:
    """Return what rosbag2 wants to know of a bag.

    Args:
        files: of the bag, in the order in which they were written.
        ros_distro: name of the ROS distribution that recorded it.
    """
    counts: Counter[Topic] = Counter()
    for file in files:
        counts.update(file.counts)
    filled = [file for file in files if file.message_count]
    start = min((file.starting_time_ns for file in filled), default=0)
    end = max((file.starting_time_ns + file.duration_ns for file in filled), default=0)
    return {
        'version': FORMAT_VERSION,
        'storage_identifier': 'mcap',
        'duration': {'nanoseconds': end - start},
        'starting_time': {'nanoseconds_since_epoch': start},
        'message_count': sum(counts.values()),
        'topics_with_message_count': [
            {'topic_metadata': _topic_content(topic), 'message_count': count}
            for topic, count in counts.items()
        ],
        # MCAP compresses its chunks itself: to rosbag2 such a bag is not compressed.
        'compression_format': '',
        'compression_mode': '',
        'relative_file_paths': [file.name for file in files],
        'files': [
            {
                'path': file.name,
                'starting_time': {'nanoseconds_since_epoch': file.starting_time_ns},
                'duration': {'nanoseconds': file.duration_ns},
                'message_count': file.message_count,
            }
            for file in files
        ],
        'custom_data': None,
        'ros_distro': ros_distro,
    }


def bag_text(content: dict[str, Any]) -> str:
    """Return the content of a bag as the YAML that stands in the MCAP file itself."""
    return yaml.dump(content, Dumper=_DUMPER, sort_keys=False)


def read_metadata(folder: Path) -> dict[str, Any]:
    """Return the content of `metadata.yaml`.

    Raises:
        OSError: there is no such file.
        ValueError: it is not that of a bag.
    """
    try:
        document = yaml.safe_load((folder / FILE_NAME).read_text())
    # A cut off or overwritten file is no YAML, or one of another shape.
    except (yaml.YAMLError, RecursionError) as error:
        raise ValueError('no YAML') from error
    content = document.get(_KEY) if isinstance(document, dict) else None
    if not isinstance(content, dict):
        raise ValueError(f'no {_KEY}')
    return content


def file_names(folder: Path) -> list[str]:
    """Return the names of the MCAP files that `metadata.yaml` lists, in the order of the recording.

    Raises:
        OSError: there is no such file.
        ValueError: it is not that of a bag.
    """
    names = read_metadata(folder).get('relative_file_paths')
    if not isinstance(names, list) or not names or not all(isinstance(n, str) for n in names):
        raise ValueError('no list of relative_file_paths')
    return names


def write_metadata(folder: Path, content: dict[str, Any]) -> None:
    """Write `metadata.yaml` whole or not at all."""
    text = bag_text({_KEY: content})
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
