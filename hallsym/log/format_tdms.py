"""TDMS logs of LabVIEW and its kin, through npTDMS (an extra): channels in groups, read chunk by chunk."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

from hallsym.errors import InputError, quoted
from hallsym.log.pace import pace_in
from hallsym.log.table import Source, load
from hallsym.log.vectors import Stored, arranged, unit_in


def open_tdms(path: Path, clock: str | None = None) -> Source:
    """Open a TDMS file; `clock`: as `GroupedSource` reads it."""
    where, opened = quoted(path), partial(_opened, path)
    arrays, left_out = dict[str, Stored](), dict[str, str]()
    with opened() as file:
        if file.file_status.incomplete_final_segment:
            raise InputError(f"Log {where} must be a complete TDMS file; its last segment is cut short.")
        for channel in (channel for group in file.groups() for channel in group.channels()):
            if len(channel) == 0 or channel.dtype.kind not in "fiuM":
                left_out[channel.name] = "it holds no numbers"
                continue
            arrays[f"{channel.group_name}/{channel.name}"] = Stored(
                (len(channel),), channel.dtype, partial(_found, channel.group_name, channel.name),
                unit_in(channel.properties), pace_in(channel.properties),
            )  # fmt: skip
    return arranged(where, "TDMS", arrays, left_out, "/", clock, opened)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    library = load("nptdms")
    load("nptdms.log").log_manager.set_level(logging.CRITICAL)  # what it warns of is raised here
    with open(path, "rb") as stream, library.TdmsFile.open(stream) as file:
        yield file


def _found(group: str, channel: str, file: Any, field: str) -> Any:
    return file[group][channel]
