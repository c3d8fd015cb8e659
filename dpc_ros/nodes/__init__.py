"""The ROS 2 nodes: thin adapters around the core. Only here is rclpy imported."""

import sys
from types import TracebackType


def _end_quietly(
    kind: type[BaseException], error: BaseException, traceback: TracebackType | None
) -> None:
    """Show no traceback where a Ctrl-C ends a program that has not begun, or has ended."""
    if not issubclass(kind, KeyboardInterrupt):
        sys.__excepthook__(kind, error, traceback)


# Only for what nobody has caught, and only where nobody else has said how to show it.
if sys.excepthook is sys.__excepthook__:
    sys.excepthook = _end_quietly
