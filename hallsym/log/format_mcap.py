"""MCAP logs of ROS 2, through mcap and mcap-ros2-support (an extra): a topic is a group of channels."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.columns import stems_of, unit_of
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, Arrays, load

_STAMP, _SINGLE = "header.stamp.", "data"
"""Fields with the time of measurement; field of a message that holds nothing else (std_msgs)."""
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
                groups.append(Group(topic, _topic(path, topic, schema, origin, left_out)))
    return GroupedSource(where, "MCAP", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    decoders = [load("mcap_ros2.decoder").DecoderFactory()]
    with open(path, "rb") as stream:
        yield load("mcap.reader").make_reader(stream, validate_crcs=True, decoder_factories=decoders)


def _topic(path: Path, name: str, schema: Any, origin: int, left_out: dict[str, str]) -> Arrays:
    """Return the numbers of the messages of a topic, which have one length throughout.

    Time is that of the header's stamp, where a message has a header, else that of recording, in seconds from
    `origin`, which is in nanoseconds.
    """
    with _opened(path) as reader:
        messages = reader.iter_decoded_messages(topics=[name])
        found = ((dict(_leaves(message)), raw.log_time) for _, _, raw, message in messages)
        first = leaves, _ = next(found)
        numbers = [p for p, v in leaves.items() if isinstance(v, int | float) and not isinstance(v, bool)]
        stamped = f"{_STAMP}sec" in numbers
        fields = [path for path in numbers if not path.startswith(_STAMP.partition(".")[0] + ".")]
        rows = [
            (own[f"{_STAMP}sec"] * 10**9 + own[f"{_STAMP}nanosec"] if stamped else at, *map(own.get, fields))
            for own, at in chain([first], found)
        ]
    left_out.update({path: "it holds no numbers" for path in leaves if path not in numbers})
    names = [name.rpartition("/")[2]] if fields == [_SINGLE] else fields
    said = dict(_FIELD.findall(schema.data.decode("utf-8", "replace").split("\n====")[0]))
    stems = stems_of(names, [unit_of(said.get(re.split(r"[.[]", path)[0], "")) for path in fields])
    ticks, *columns = (np.array(column) for column in zip(*rows, strict=True))
    source = Arrays({**dict(zip(stems, columns, strict=True)), TIME: (ticks - origin) * 1e-9})
    source.call({**stems, TIME: (TIME, "s")})
    source.since = "the stamps" if stamped else "the recording"
    return source


def _leaves(value: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (name, value) of what a message holds, fields of fields and elements: `pose.position[0]`."""
    if hasattr(value, "__slots__"):
        for field in value.__slots__:
            yield from _leaves(getattr(value, field), f"{name}.{field}" if name else field)
    elif isinstance(value, list | tuple | np.ndarray):
        for k, item in enumerate(value):
            yield from _leaves(item, f"{name}[{k}]")
    else:
        yield name, value
