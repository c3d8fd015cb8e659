"""What people look at: bodies in colour, the page of a log, the live viewer; no ROS."""

from .animation import NothingToShowError, animate
from .colours import strain_colours
from .packing import Quantised, packed, quantise
from .report import report_page, write_report

__all__ = [
    'NothingToShowError',
    'Quantised',
    'animate',
    'packed',
    'quantise',
    'report_page',
    'strain_colours',
    'write_report',
]
