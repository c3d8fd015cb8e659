"""Recorder node: any topics, as they come, into a rosbag2 bag (MCAP) that says what was running."""

from __future__ import annotations

import datetime
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from rclpy.context import Context
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message
from rclpy.subscription import Subscription
from rclpy.timer import Timer
from sensor_msgs.msg import JointState

from dpc_ros.bag import (
    COMMAND_RECORD,
    MACHINE_RECORD,
    MODELS_RECORD,
    NODE_PARAMETERS_RECORD,
    PARAMETERS_RECORD,
    VERSIONS_RECORD,
    BagWriter,
    Topic,
    further_folder,
)
from dpc_ros.bag.topic import NANOSECONDS
from dpc_ros.machine import describe_machine
from dpc_ros.nodes.loop_node import LoopNode, run_node
from dpc_ros.nodes.message_definition import (
    find_message_class,
    message_definition,
    message_type_name,
)
from dpc_ros.nodes.model_files import model_files
from dpc_ros.nodes.node_parameters import NodeParameters
from dpc_ros.nodes.offers import fitting_profile, hears_any, offered_profiles, type_hash
from dpc_ros.nodes.provenance import commands, ros_distribution, software_versions
from dpc_ros.nodes.topic_selection import TopicSelection
from dpc_ros.nodes.topics import LOOP_QOS, TOPICS
from dpc_ros.parameters import read_sections

_QUIET = 0.2  # s without a message after which nothing more is on its way
_ON_ITS_WAY = 2.0  # s after the stop in which may come what was published before it
_LONGEST_DRAIN = 30.0  # s in which what waits for the recorder at the stop is taken
_MODEL_TOPICS = ('configuration', 'latent_state')  # their frame_id is `<name>@<digest>`


@dataclass
class _Recorded:
    """A topic that is subscribed to."""

    message_type: type[Any]
    profile: QoSProfile
    subscription: Subscription
    is_of_loop: bool
    publishers: int = 0
    is_in_bag: bool = False
    heard: set[tuple[int, int]] = field(default_factory=set)  # before a publisher was known

    def has_heard(self, info: dict[str, int]) -> bool:
        """Return whether a message came before, to a subscription that asked for less."""
        message = info['source_timestamp'], info['publication_sequence_number']
        if not self.publishers and not self.is_of_loop:
            self.heard.add(message)
            return False
        return message in self.heard


class RecorderNode(LoopNode):
    """Writes raw CDR bytes: nothing is deserialised, nothing is rounded.

    Topics of the loop are subscribed to before anyone publishes them, others as the graph shows
    them. Told to stop, it takes what has been published up to then, and no more. Configured again,
    it goes on in a further bag: `<bag>_1`, ….
    """

    acts_to_the_end = True
    gathering_s = 0.01

    def __init__(self, context: Context | None = None) -> None:
        super().__init__('recorder', context)
        self._writer: BagWriter | None = None
        self._recorded: dict[str, _Recorded] = {}
        self._refused: set[str] = set()  # topics that can't be recorded, and have been reported
        self._attached: set[tuple[str, str]] = set()
        self._ticks: list[Timer] = []
        self._questions: NodeParameters | None = None
        self._last_message = time.monotonic()
        self._end_ns: int | None = None  # what is published later is not recorded
        self._ended_at = 0.0
        self._has_recorded = False

    def configure(self) -> None:
        settings = self.settings
        self._selection = TopicSelection(
            settings['topics'],
            settings['exclude'],
            self.get_namespace(),
            self.resolve_topic_name,
        )
        parameters_file = settings['parameters_file']
        parameters = Path(parameters_file).read_text() if parameters_file else ''
        sections = read_sections(parameters, parameters_file) if parameters else {}
        folder = Path(settings['bag'] or f'bag_{datetime.datetime.now():%Y%m%d_%H%M%S}')
        self._writer = BagWriter(
            further_folder(folder) if self._has_recorded else folder,
            ros_distro=ros_distribution(),
            chunk_size=settings['chunk_size'],
            split_size=settings['split_size'],
            split_duration_ns=round(settings['split_duration'] * NANOSECONDS),
        )
        self._has_recorded = True
        self._writer.add_metadata(MACHINE_RECORD, describe_machine())
        self._writer.add_metadata(VERSIONS_RECORD, software_versions())
        self._writer.add_metadata(COMMAND_RECORD, commands())
        if parameters:
            self._writer.add_metadata(PARAMETERS_RECORD, {'yaml': parameters})
            for section in sections.values():
                self._attach(section)
        self.health.readings |= {'bag': str(self._writer.folder), 'recorded [bytes]': 0}
        self._questions = NodeParameters(self, self._keep_parameters)
        self.get_logger().info(f'recording to {self._writer.folder}')

    def activate(self) -> None:
        if self._ticks:
            return  # it listened while it was inactive
        # Not before: what is latched comes once, and is for the log.
        for topic, entry in TOPICS.items():
            name = self.resolve_topic_name(topic)
            if self._selection.selects(name):
                self._subscribe(name, entry.message_type, entry.qos, is_of_loop=True)
        # Half the interval: a tick may come late, a message may not wait longer than promised.
        for period, action in (
            (self.settings['sync_interval'] / 2, self._sync),
            (self.settings['discovery_interval'], self._look_around),
        ):
            self._ticks.append(self.create_timer(period, action, clock=self._steady_clock))
        self._look_around()

    def clean_up(self) -> None:
        for timer in self._ticks:
            self.destroy_timer(timer)
        self._ticks.clear()
        if self._questions is not None:
            self._questions.close()
        for recorded in self._recorded.values():
            self.destroy_subscription(recorded.subscription)
        self._recorded.clear()
        self._refused.clear()
        self._attached.clear()
        writer, self._writer = self._writer, None
        if writer is not None:
            with self._writing(writer):
                writer.close()
            if not writer.is_whole:
                self.failure += '; its last file has no end, which `dpc bag repair` can give it'

    def is_drained(self) -> bool:
        if self._end_ns is None:
            self._end_ns = time.time_ns()
            self._ended_at = self._last_message = time.monotonic()
        now = time.monotonic()
        # The steady clock has the last word: a wall clock that is set may not hold up the end.
        return now - self._last_message > _QUIET or now - self._ended_at > _LONGEST_DRAIN

    def finish(self) -> None:
        if self._writer is not None:
            count = sum(self._writer.message_counts.values())
            lost = self.health.lost.total()
            self.get_logger().info(f'recorded {count} messages, {lost} lost')

    def _look_around(self) -> None:
        """Subscribe to topics that have appeared, ask nodes that have."""
        for name, types in self.get_topic_names_and_types():
            if name in self._recorded:
                self._follow_publishers(name, self._recorded[name])
            elif name not in self._refused and self._selection.selects(name):
                self._begin(name, types)
        if self._questions is not None:
            self._questions.look()

    def _begin(self, name: str, types: list[str]) -> None:
        try:
            if len(types) > 1:
                raise ValueError(f'expected one type of message, got {", ".join(types)}')
            message_type = find_message_class(types[0])
            message_definition(message_type)
        except ValueError as error:
            self._refused.add(name)
            self.health.rejected[f'{name}: {error}'] += 1
            self.say(f'{name} is not recorded: {error}', problem=True)
            return
        publishers = self.get_publishers_info_by_topic(name)
        fitting = fitting_profile(publishers, LOOP_QOS.depth) if publishers else LOOP_QOS
        self._subscribe(name, message_type, fitting)

    def _follow_publishers(self, name: str, recorded: _Recorded) -> None:
        """Ask for what is offered, where the first publishers come after the subscription.

        Topics of the loop stay as they are: the log holds what the loop can hear, and no more.
        """
        count = self.count_publishers(name)
        if recorded.is_of_loop or count == recorded.publishers:
            return
        is_first = not recorded.publishers
        publishers = self.get_publishers_info_by_topic(name)
        recorded.publishers = count
        if not publishers or (recorded.is_in_bag and not is_first):
            return
        fitting = fitting_profile(publishers, LOOP_QOS.depth)
        misses_latched = fitting.durability != recorded.profile.durability
        if misses_latched or not hears_any(recorded.profile, publishers):
            self.destroy_subscription(recorded.subscription)
            self._sequences.pop(name, None)  # what was kept comes with its numbers again
            recorded.profile = fitting
            recorded.subscription = self._listen(name, recorded.message_type, fitting)

    def _subscribe(
        self, name: str, message_type: type[Any], offered: QoSProfile, is_of_loop: bool = False
    ) -> None:
        # Deep on every topic: also one with depth 1 may bring several before they are taken.
        profile = QoSProfile(
            depth=LOOP_QOS.depth, reliability=offered.reliability, durability=offered.durability
        )
        subscription = self._listen(name, message_type, profile)
        self._recorded[name] = _Recorded(message_type, profile, subscription, is_of_loop)

    def _listen(self, name: str, message_type: type[Any], profile: QoSProfile) -> Subscription:
        record = partial(self._record, name)
        return self.create_subscription(message_type, name, record, profile, raw=True)

    def _record(self, name: str, data: bytes, info: dict[str, int]) -> None:
        if self._end_ns is not None and self._is_too_late(info, self._end_ns):
            return
        number = info['publication_sequence_number']
        gap = self._sequences[name].gap(number, partial(self.count_publishers, name))
        self.health.arrived(info)
        self.health.lost[name] += gap
        writer = self._writer
        if not self.active or writer is None or self._recorded[name].has_heard(info):
            return
        begin = self._last_message = time.monotonic()
        with self._writing(writer):
            if not self._recorded[name].is_in_bag:
                self._introduce(writer, name, data)
            if gap:
                writer.count_lost(name, gap)
            writer.write(
                name,
                data,
                log_time_ns=info['received_timestamp'],
                publish_time_ns=info['source_timestamp'],
                sequence=number,
            )
            self.health.published += 1
            self.health.readings['recorded [bytes]'] += len(data)
        self.health.processed(time.monotonic() - begin)

    def _is_too_late(self, info: dict[str, int], end_ns: int) -> bool:
        """Return whether a message was published after the end.

        What the middleware had received by then was not. Else the publisher's clock says so, but
        it may be behind: it is believed only while something may still be on its way.
        """
        if info['received_timestamp'] <= end_ns:
            return False
        is_overdue = time.monotonic() - self._ended_at > _ON_ITS_WAY
        return is_overdue or info['source_timestamp'] > end_ns

    def _introduce(self, writer: BagWriter, name: str, data: bytes) -> None:
        """Say in the log what a topic is, with its first message."""
        recorded = self._recorded[name]
        recorded.is_in_bag = True
        publishers = self.get_publishers_info_by_topic(name)
        writer.add_topic(
            Topic(
                name=name,
                type_name=message_type_name(recorded.message_type),
                definition=message_definition(recorded.message_type),
                offered_qos_profiles=offered_profiles(publishers),
                type_hash=type_hash(publishers),
            )
        )
        writer.count_lost(name, 0)
        if name.rpartition('/')[2] in _MODEL_TOPICS and recorded.message_type is JointState:
            model = deserialize_message(data, JointState).header.frame_id
            writer.add_metadata(MODELS_RECORD, {name: model})

    def _keep_parameters(self, node: str, parameters: Mapping[str, Any]) -> None:
        if self._writer is None or self.failure:
            return
        content = {node: {'ros__parameters': dict(parameters)}}
        text = yaml.safe_dump(content, sort_keys=False)
        with self._writing(self._writer):
            self._writer.add_metadata(NODE_PARAMETERS_RECORD, {node: text})
            self._attach(parameters)

    def _attach(self, parameters: Mapping[str, Any]) -> None:
        """Put the files that a node's parameters name into the log, as far as that was asked for.

        Raises:
            OSError: the log can't be written.
        """
        for kind in self.settings['attach']:
            value = parameters.get(kind)
            if (
                self._writer is None
                or not isinstance(value, str)
                or (kind, value) in self._attached
            ):
                continue
            self._attached.add((kind, value))
            try:
                files = model_files(kind, value)
            except OSError as error:
                self.say(f'the {kind} is not attached: {error}', problem=True)
                continue
            for file in files:
                self._writer.add_attachment(file.name, file.media_type, file.data, time.time_ns())

    def _sync(self) -> None:
        if self._writer is not None and not self.failure:
            with self._writing(self._writer):
                self._writer.sync()

    @contextmanager
    def _writing(self, writer: BagWriter) -> Iterator[None]:
        """End the recording where the log can't be written; what is written stays."""
        try:
            yield
        except OSError as error:
            if not self.failure:
                self.fail(
                    f'{writer.folder} can not be written any further ({error.strerror or error}): '
                    'what was recorded before is kept; make room or choose another folder by `bag`'
                )


def main(arguments: list[str] | None = None) -> None:
    """Run the node as a process."""
    sys.exit(run_node(RecorderNode, arguments))


if __name__ == '__main__':
    main()
