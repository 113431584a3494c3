"""Sensor logs: read, check and write them; SI units, split into runs, with what is known of their noise."""

from hallsym.log.check import check_log, clean_log, spans
from hallsym.log.columns import Foreign, parse_column_option, read_column_file
from hallsym.log.core import Block, Log
from hallsym.log.estimate import estimate_noise
from hallsym.log.meta import Meta
from hallsym.log.noise import Noise, Sigma
from hallsym.log.read import read_log
from hallsym.log.scan import Span, Spans
from hallsym.log.write import LogWriter, write_log

__all__ = [
    "Block",
    "Foreign",
    "Log",
    "LogWriter",
    "Meta",
    "Noise",
    "Sigma",
    "Span",
    "Spans",
    "check_log",
    "clean_log",
    "estimate_noise",
    "parse_column_option",
    "read_column_file",
    "read_log",
    "spans",
    "write_log",
]
