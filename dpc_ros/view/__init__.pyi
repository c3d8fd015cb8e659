"""What people look at: bodies in colour, the page of a log, the live viewer; no ROS."""

from .actions import Actions
from .animation import NothingToShowError, animate
from .colours import strain_colours
from .frame import Frame
from .live import LivePage
from .log import LogPage, RecordedFrames
from .packing import Quantised, packed, quantise
from .report import report_page, write_report
from .server import ViewerError, address, open_server

__all__ = [
    'Actions',
    'Frame',
    'LivePage',
    'LogPage',
    'NothingToShowError',
    'Quantised',
    'RecordedFrames',
    'ViewerError',
    'address',
    'animate',
    'open_server',
    'packed',
    'quantise',
    'report_page',
    'strain_colours',
    'write_report',
]
