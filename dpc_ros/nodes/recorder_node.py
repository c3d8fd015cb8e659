"""Recorder node: the topics of the loop, as they come, into a rosbag2 bag (MCAP)."""

from __future__ import annotations

import datetime
import os
import sys
import time
from functools import partial
from pathlib import Path

from rclpy.context import Context
from rclpy.qos import QoSProfile as RclpyQoS
from rclpy.topic_endpoint_info import TopicEndpointInfo

from dpc_ros.bag import MACHINE_RECORD, PARAMETERS_RECORD, BagWriter, QosProfile, Topic
from dpc_ros.machine import describe_machine
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.message_definition import message_definition, message_type_name
from dpc_ros.nodes.topics import TOPICS

_QUIET = 0.2  # s without a message after which nothing more is on its way


class RecorderNode(LoopNode):
    """Writes raw CDR bytes: nothing is deserialised, nothing is rounded.

    Told to stop, it takes what has been published up to then, and no more.
    """

    acts_to_the_end = True

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('recorder', context)
        self._writer: BagWriter | None = None
        self._last_message = time.monotonic()
        self._end_ns: int | None = None  # what is published later is not recorded

    def configure(self) -> None:
        settings = self.settings
        parameters_file = settings['parameters_file']
        parameters = Path(parameters_file).read_text() if parameters_file else ''
        self._writer = BagWriter(
            settings['bag'] or f'bag_{datetime.datetime.now():%Y%m%d_%H%M%S}',
            ros_distro=os.environ.get('ROS_DISTRO', 'jazzy'),
            chunk_size=settings['chunk_size'],
        )
        self._writer.add_metadata(MACHINE_RECORD, describe_machine())
        if parameters:
            self._writer.add_metadata(PARAMETERS_RECORD, {'yaml': parameters})
        for topic in settings['topics']:
            self.create_input(topic, partial(self._record, topic), raw=True)
        self.get_logger().info(f'recording to {self._writer.folder}')

    def clean_up(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            try:
                writer.close()
            except OSError as error:
                self.failure = self.failure or f'{writer.folder} can not be finished: {error}'

    def is_drained(self) -> bool:
        if self._end_ns is None:
            self._end_ns = time.time_ns()
            self._last_message = time.monotonic()
        return time.monotonic() - self._last_message > _QUIET

    def finish(self) -> None:
        if self._writer is not None:
            count = sum(self._writer.message_counts.values())
            self.get_logger().info(f'recorded {count} messages, {self.health.lost} lost')

    def _record(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        if self._end_ns is not None and info['source_timestamp'] > self._end_ns:
            return
        if not self.receive(topic, info) or self._writer is None:
            return
        self._last_message = time.monotonic()
        try:
            self._write(self._writer, topic, data, info)
        except OSError as error:
            self.fail(f'{self._writer.folder} can not be written any further: {error}')

    def _write(self, writer: BagWriter, topic: str, data: bytes, info: dict[str, int]) -> None:
        name = self.resolve_topic_name(topic)
        if name not in writer.message_counts:
            writer.add_topic(self._describe(topic, name))
        writer.write(
            name,
            data,
            log_time_ns=info['received_timestamp'],
            publish_time_ns=info['source_timestamp'],
            sequence=info['publication_sequence_number'],
        )

    def _describe(self, topic: str, name: str) -> Topic:
        message_type = TOPICS[topic].message_type
        publishers = self.get_publishers_info_by_topic(name)
        return Topic(
            name=name,
            type_name=message_type_name(message_type),
            definition=message_definition(message_type),
            offered_qos_profiles=tuple(_offered(each.qos_profile) for each in publishers),
            type_hash=_type_hash(publishers),
        )


def _type_hash(publishers: list[TopicEndpointInfo]) -> str:
    text = str(publishers[0].topic_type_hash) if publishers else ''
    return text if text.startswith('RIHS01_') else ''  # rclpy says INVALID where it has none


def _offered(qos: RclpyQoS) -> QosProfile:
    return QosProfile(
        history=qos.history.short_key,
        depth=qos.depth,
        reliability=qos.reliability.short_key,
        durability=qos.durability.short_key,
    )


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(RecorderNode, arguments))


if __name__ == '__main__':
    main()
