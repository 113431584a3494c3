"""MCAP logs of ROS 2, through mcap and mcap-ros2-support (an extra): a topic is a group of channels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import partial, reduce
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.columns import unit_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, load
from hallsym.log.vectors import Vectors
from hallsym.units import Array

_STAMP, _SINGLE = "header", "data"
"""Field with the time of measurement; field of a message that holds nothing else (std_msgs)."""
_FIELD = re.compile(r"^\s*[\w/<>=\[\]]+\s+(\w+)\s*(?:\S+\s*)?#[^\[\n]*\[([^\]\n]+)\]", re.MULTILINE)
"""A line of a message definition whose comment states a unit: `float64 hall_a  # probe A [um]`."""


def open_mcap(path: Path, clock: str | None = None) -> GroupedSource:
    """Open an MCAP file; `clock`: as `GroupedSource` reads it."""
    where = quoted(path)
    left_out: dict[str, str] = {}
    groups = []
    with _opened(path) as reader:
        summary = reader.get_summary()
        if summary is None or summary.statistics is None:
            raise InputError(
                f"Log {where} must be a complete MCAP file; it has no summary, so the recording broke off:"
                " run 'mcap recover' on it."
            )
        counts = summary.statistics.channel_message_counts
        origin = summary.statistics.message_start_time
        topics: dict[str, list[Any]] = {}
        for key, channel in summary.channels.items():
            topics.setdefault(channel.topic, []).append((channel, counts.get(key, 0)))
        for topic, members in topics.items():
            channel, rows = members[0][0], sum(count for _, count in members)
            if channel.message_encoding != "cdr":
                left_out[topic] = (
                    f"its messages are encoded as {channel.message_encoding}, not of ROS 2 (cdr)"
                )
            elif rows:
                schema = summary.schemas[channel.schema_id]
                groups.append(Group(topic, _topic(path, topic, rows, schema, origin, left_out)))
    return GroupedSource(where, "MCAP", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    decoders = [load("mcap_ros2.decoder").DecoderFactory()]
    with open(path, "rb") as stream:
        yield load("mcap.reader").make_reader(stream, validate_crcs=True, decoder_factories=decoders)


@contextmanager
def _messages(path: Path, topic: str, reverse: bool = False) -> Iterator[Any]:
    """Open a topic: its messages, each with what was recorded of it, in the order of their times."""
    with _opened(path) as reader:
        found = reader.iter_decoded_messages(topics=[topic], reverse=reverse)
        yield ((message, raw) for _, _, raw, message in found)


def _topic(path: Path, name: str, rows: int, schema: Any, origin: int, left_out: dict[str, str]) -> Vectors:
    """Return the numbers of the messages of a topic, which have one length throughout.

    Time is that of the header's stamp, where a message has a header, else that of recording, in seconds from
    `origin`, which is in nanoseconds.
    """
    ends = []
    for reverse in (False, True):
        with _messages(path, name, reverse) as messages:
            ends.append(next(messages))
    leaves = dict(_leaves(ends[0][0]))
    numbers = [path for path, v in leaves.items() if isinstance(v, int | float) and not isinstance(v, bool)]
    left_out.update({_called(path): "it holds no numbers" for path in leaves if path not in numbers})
    stamped = (_STAMP, "stamp", "sec") in numbers
    paths = {_called(path): path for path in numbers if path[0] != _STAMP or len(path) == 1}
    paths = {name.rpartition("/")[2]: path for path in paths.values()} if [*paths] == [_SINGLE] else paths
    said = dict(_FIELD.findall(schema.data.decode("utf-8", "replace").split("\n====")[0]))
    units = {key: unit_of(said.get(str(path[0]), "")) for key, path in paths.items()}

    def time(message: Any, raw: Any) -> float:
        stamp = message.header.stamp if stamped else None
        return ((stamp.sec * 1_000_000_000 + stamp.nanosec if stamp else raw.log_time) - origin) * 1e-9

    def read(messages: Iterator[Any], names: Sequence[str], lo: int, hi: int) -> list[Array]:
        values_of = [
            [time(message, raw) if n == TIME else _leaf(message, paths[n]) for n in names]
            for message, raw in islice(messages, hi - lo)
        ]
        return [np.array([row[k] for row in values_of]) for k in range(len(names))]

    since = "the stamps" if stamped else "the recording"
    first, last = (time(*end) for end in ends)
    return Vectors({**units, TIME: "s"}, rows, read, partial(_messages, path, name), (first, last), since)


def _leaves(value: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield (path, value) of what a message holds: fields of fields, elements of arrays."""
    if hasattr(value, "__slots__"):
        for field in value.__slots__:
            yield from _leaves(getattr(value, field), (*path, field))
    elif isinstance(value, list | tuple | np.ndarray):
        for k, item in enumerate(value):
            yield from _leaves(item, (*path, k))
    else:
        yield path, value


def _called(path: Sequence[str | int]) -> str:
    """Return the name of a leaf: `pose.position[0]`."""
    return "".join(f"[{step}]" if isinstance(step, int) else f".{step}" for step in path)[1:]


def _leaf(message: Any, path: Sequence[str | int]) -> Any:
    """Return a leaf of a message by its path."""
    return reduce(lambda m, step: m[step] if isinstance(step, int) else getattr(m, step), path, message)
