"""MCAP logs of ROS 2, through mcap and mcap-ros2-support (an extra): a topic is a group of channels."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import InputError, quoted
from hallsym.log.groups import Group, GroupedSource
from hallsym.log.table import TIME, Source, load
from hallsym.log.text.cells import stems_of, unit_of
from hallsym.units import Array

AT_ONCE = 4096
"""Messages that are decoded before they become arrays."""
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
        numbers = {path: v for path, v in leaves.items() if isinstance(v, int | float)}
        numbers = {path: v for path, v in numbers.items() if not isinstance(v, bool)}
        left_out.update({key: "it holds no numbers" for key in leaves if key not in numbers})
        stamped = f"{_STAMP}.stamp.sec" in numbers
        self.stamped = stamped
        self.paths = [key for key in numbers if not key.startswith(f"{_STAMP}.")]
        single = name.rpartition("/")[2] if self.paths == [_SINGLE] else ""
        said = dict(_FIELD.findall(schema.data.decode("utf-8", "replace").split("\n====")[0]))
        texts = {single or key: unit_of(said.get(re.split(r"[.\[]", key)[0], "")) for key in self.paths}
        self.call(stems_of(texts, texts))
        self.own = dict(zip(self.names, self.paths, strict=True))
        self.names, self.units = (*self.names, TIME), {**self.units, TIME: "s"}
        self.since = "the stamps" if stamped else "the recording"
        self.ends = self._time(*head), self._time(*tail)

    def chunks(self, names: Sequence[str], size: int) -> Iterator[Mapping[str, Array]]:
        """Yield consecutive chunks of some rows."""
        rows = 0
        for piece in self._decoded(names):
            rows += len(piece[names[0]])
            yield piece
        if rows != self.rows:
            raise ValueError(f"topic {self.name} has {rows} of its {self.rows} messages")

    def _decoded(self, names: Sequence[str]) -> Iterator[Mapping[str, Array]]:
        keys = [_getter(self.own[name]) if name != TIME else None for name in names]
        held: list[list[float]] = []
        with _opened(self.path) as reader:
            for _, _, raw, message in reader.iter_decoded_messages(topics=[self.name]):
                held.append([self._time(message, raw) if key is None else key(message) for key in keys])
                if len(held) == AT_ONCE:
                    yield _columns(names, held)
                    held = []
        if held:
            yield _columns(names, held)

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


def _columns(names: Sequence[str], rows: list[list[float]]) -> Mapping[str, Array]:
    return {name: np.array(values) for name, values in zip(names, zip(*rows, strict=True), strict=True)}


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield (path, value) of what a message holds: fields of fields, elements of arrays `name[0]`."""
    fields = getattr(value, "__slots__", None)
    if fields is not None:
        for field in fields:
            yield from _leaves(getattr(value, field), f"{path}.{field}" if path else field)
    elif isinstance(value, list | tuple | np.ndarray):
        for k, item in enumerate(value):
            yield from _leaves(item, f"{path}[{k}]")
    else:
        yield path, value


def _getter(path: str) -> Any:
    """Return what reads a leaf of a message by its path."""
    steps = [int(step) if step.isdecimal() else step for step in re.findall(r"\w+", path)]

    def get(message: Any) -> Any:
        for step in steps:
            message = message[step] if isinstance(step, int) else getattr(message, step)
        return message

    return get
