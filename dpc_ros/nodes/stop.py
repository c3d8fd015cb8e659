"""Stopping: Ctrl-C and SIGTERM ask, nobody is cut off."""

from __future__ import annotations

import os
import signal
import sys
from types import TracebackType

import rclpy
from rclpy.context import Context
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dpc_ros.nodes.discovery import prompt_dds
from dpc_ros.nodes.program import PARENT_VARIABLE

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class StopRequest:
    """A rclpy context for one process, and whether a signal has asked it to stop.

    rclpy's own handlers shut the context down at once, which would lose what is still on its way.
    A process that the launcher started (`PARENT_VARIABLE`) stops, too, when the launcher is gone.

    Args:
        arguments: for rclpy; where none are given, those of the process.
        domain: of DDS; where none is given, that of the environment.

    Raises:
        ValueError: on entering, for arguments that rclpy can't read, or that are not for it.
    """

    def __init__(self, arguments: list[str] | None = None, domain: int | None = None) -> None:
        self.context = Context()
        self._domain = domain
        self._arguments = sys.argv[1:] if arguments is None else arguments
        self._asked = False
        parent = os.environ.get(PARENT_VARIABLE)
        self._parent = None if parent is None else int(parent)
        self._previous: dict[int, object] = {}

    def __bool__(self) -> bool:
        return (
            self._asked
            or (self._parent is not None and os.getppid() != self._parent)
            or not self.context.ok()
        )

    def __enter__(self) -> StopRequest:
        for number in _SIGNALS:
            # one that whoever started the process ignores for it, as `nohup` does, stays so
            if number == signal.SIGINT or signal.getsignal(number) is not signal.SIG_IGN:
                self._previous[number] = signal.signal(number, self._ask)
        try:
            self._initialize()
        except ValueError:
            self.__exit__(None, None, None)
            raise
        return self

    def _initialize(self) -> None:
        try:
            others = remove_ros_args(['node', *self._arguments])[1:]
            with prompt_dds(self._arguments):
                rclpy.init(
                    args=self._arguments,
                    context=self.context,
                    domain_id=self._domain,
                    signal_handler_options=SignalHandlerOptions.NO,
                )
        except RuntimeError as error:  # the base of what rclpy raises for bad arguments
            raise ValueError(f'ROS arguments: {str(error).splitlines()[0]}') from error
        if others:  # rclpy would pass over them without a word
            raise ValueError(
                f'unknown arguments {" ".join(others)!r}: expected `--ros-args -p name:=value` or '
                '`--ros-args --params-file file.yaml`; config/nodes/ lists the parameters'
            )

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)  # type: ignore[arg-type]
        self.context.try_shutdown()

    def _ask(self, number: int, frame: object) -> None:
        self._asked = True
