"""MCAP logs of ROS 2, through mcap and mcap-ros2-support (an extra): a topic is a group of channels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import reduce
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, Source, load
from hallsym.log.text.cells import stems_of, unit_of
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
                groups.append(Group(topic, Topic(path, topic, rows, schema, origin, left_out)))
    return GroupedSource(where, "MCAP", groups, left_out, clock)


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    decoders = [load("mcap_ros2.decoder").DecoderFactory()]
    with open(path, "rb") as stream:
        yield load("mcap.reader").make_reader(stream, validate_crcs=True, decoder_factories=decoders)


class Topic(Source):
    """Numbers of the messages of one topic, which have one length throughout.

    Time is that of the header's stamp, where a message has a header, else that of recording.
    """

    path: Path

    def __init__(
        self, path: Path, name: str, rows: int, schema: Any, origin: int, left_out: dict[str, str]
    ) -> None:
        """Look at the first and the last message; `origin`: nanoseconds that count as zero."""
        self.path, self.name, self.rows, self.origin = path, name, rows, origin
        head, tail = self._end(False), self._end(True)
        leaves = dict(_leaves(head[0]))
        numbers = [
            path for path, v in leaves.items() if isinstance(v, int | float) and not isinstance(v, bool)
        ]
        left_out.update({_called(path): "it holds no numbers" for path in leaves if path not in numbers})
        self.stamped = (_STAMP, "stamp", "sec") in numbers
        paths = {_called(path): path for path in numbers if path[0] != _STAMP or len(path) == 1}
        single = name.rpartition("/")[2] if [*paths] == [_SINGLE] else ""
        said = dict(_FIELD.findall(schema.data.decode("utf-8", "replace").split("\n====")[0]))
        texts = {single or key: unit_of(said.get(str(path[0]), "")) for key, path in paths.items()}
        self.call(stems_of(texts, texts))
        self.own = dict(zip(self.names, paths.values(), strict=True))
        self.names, self.units = (*self.names, TIME), {**self.units, TIME: "s"}
        self.since = "the stamps" if self.stamped else "the recording"
        self.ends = self._time(*head), self._time(*tail)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of `size` rows."""
        rows, paths = 0, [self.own.get(name) for name in names]
        with _opened(self.path) as reader:
            messages = reader.iter_decoded_messages(topics=[self.name])
            while held := [
                [self._time(message, raw) if path is None else _leaf(message, path) for path in paths]
                for _, _, raw, message in islice(messages, size)
            ]:
                rows += len(held)
                columns = zip(names, zip(*held, strict=True), strict=True)
                yield {name: np.array(values) for name, values in columns}
        if rows != self.rows:
            raise ValueError(f"topic {self.name} has {rows} of its {self.rows} messages")

    def _time(self, message: Any, raw: Any) -> float:
        """Return the time of a message in seconds since the origin."""
        if not self.stamped:
            return (raw.log_time - self.origin) * 1e-9
        stamp = message.header.stamp
        return (stamp.sec * 1_000_000_000 + stamp.nanosec - self.origin) * 1e-9

    def _end(self, last: bool) -> tuple[Any, Any]:
        with _opened(self.path) as reader:
            for _, _, raw, message in reader.iter_decoded_messages(topics=[self.name], reverse=last):
                return message, raw
        raise ValueError(f"topic {self.name} holds none of its {self.rows} messages")


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
