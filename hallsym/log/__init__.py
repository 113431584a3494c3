"""Sensor logs: read, check and write them; SI units, split into runs, with their noise."""

from hallsym.log.batches import Batch, Weigh, batches
from hallsym.log.columns import Foreign, parse_column_option, read_column_file
from hallsym.log.core import Block, Drop, Log, without
from hallsym.log.derived import extended
from hallsym.log.estimate import estimate_noise
from hallsym.log.formats import as_log, open_source, read_log
from hallsym.log.meta import Meta, Noise, Sigma, check_noise_keys, meta_schema
from hallsym.log.phase import continuous, near, unwrapped, wrapped
from hallsym.log.quality.check import check_log, clean_log, spans, usable
from hallsym.log.quality.findings import LAYOUT, STUCK, UNRELATED, Fault
from hallsym.log.write import LogWriter, write_log

__all__ = [
    "LAYOUT",
    "STUCK",
    "UNRELATED",
    "Batch",
    "Block",
    "Drop",
    "Fault",
    "Foreign",
    "Log",
    "LogWriter",
    "Meta",
    "Noise",
    "Sigma",
    "Weigh",
    "as_log",
    "batches",
    "check_log",
    "check_noise_keys",
    "clean_log",
    "continuous",
    "estimate_noise",
    "extended",
    "meta_schema",
    "near",
    "open_source",
    "parse_column_option",
    "read_column_file",
    "read_log",
    "spans",
    "unwrapped",
    "usable",
    "without",
    "wrapped",
    "write_log",
]
