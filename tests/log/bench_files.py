"""One log as test benches write it: TDMS, MDF and MCAP, by the libraries of these formats."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hallsym.log import isolated

Columns = Mapping[str, np.ndarray]
Rates = Mapping[str, tuple[float, float, Columns]]
"""Group -> (first time in s, samples a second, columns under our SI names)."""
UNITS = {"m": ("µm", 1e6), "rad": ("µrad", 1e6), "v": ("mV", 1e3)}
"""SI unit -> unit in which a bench writes it, and its factor."""


def foreign(column: str) -> tuple[str, str, float]:
    """Name, unit and factor of a column as a bench writes it."""
    stem, _, si = column.rpartition("_")
    return (stem, *UNITS[si]) if si in UNITS else (column, "", 1.0)


def write_tdms(path: Path, groups: Rates, segment: int = 997) -> None:
    """Write every group in segments, with the properties of a waveform."""
    from nptdms import ChannelObject, TdmsWriter

    start = np.datetime64("2026-01-01T00:00:00", "us")
    with TdmsWriter(str(path)) as writer:
        for name, (first, rate, columns) in groups.items():
            rows = len(next(iter(columns.values())))
            for lo in range(0, rows, segment):
                objects = []
                for column, values in columns.items():
                    own, unit, factor = foreign(column)
                    stated: dict[str, Any] = {"wf_increment": 1 / rate, "wf_start_offset": 0.0}
                    stated |= {"wf_start_time": start + np.timedelta64(round(first * 1e6), "us")}
                    stated |= {"unit_string": unit} if unit else {}
                    objects.append(ChannelObject(name, own, values[lo : lo + segment] * factor, stated))
                writer.write_segment(objects)


def write_mdf(path: Path, groups: Rates, version: str = "4.10", compression: int = 0) -> None:
    """Write every group with its own master channel."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from asammdf import MDF, Signal

        file = MDF(version=version)
        for name, (first, rate, columns) in groups.items():
            signals = []
            for column, values in columns.items():
                own, unit, factor = foreign(column)
                time = first + np.arange(len(values)) / rate
                signals.append(Signal(values * factor if unit else values, time, name=own, unit=unit))
            file.append(signals, acq_name=name)
        file.save(str(path), overwrite=True, compression=compression)
        file.close()


def write_mcap(path: Path, groups: Rates) -> None:
    """Write every group as a topic of ROS 2, whose definition states the units in its comments."""
    from mcap_ros2.writer import Writer

    with open(path, "wb") as stream:
        writer = Writer(stream, chunk_size=20_000)
        messages: list[tuple[int, str, Any, dict[str, float]]] = []
        for name, (first, rate, columns) in groups.items():
            said = {column: foreign(column) for column in columns}
            text = "\n".join(
                f"{'int32' if c == 'run' else 'float64'} {own}" + (f"  # as logged [{unit}]" if unit else "")
                for c, (own, unit, _) in said.items()
            )
            schema = writer.register_msgdef(f"lab/{name}", text)
            rows = zip(*(v * said[c][2] if said[c][1] else v for c, v in columns.items()), strict=True)
            for k, row in enumerate(rows):
                values = [int(v) if c == "run" else float(v) for c, v in zip(columns, row, strict=True)]
                when = 10**18 + round((first + k / rate) * 1e9)
                fields = dict(zip((own for own, _, _ in said.values()), values, strict=True))
                messages.append((when, f"/{name}", schema, fields))
        for when, topic, schema, fields in sorted(messages, key=lambda m: m[:2]):
            writer.write_message(topic, schema, fields, log_time=when, publish_time=when)
        writer.finish()


@contextmanager
def hidden(libraries: Collection[str], folder: Path) -> Iterator[None]:
    """Let libraries be missing, here and in the processes that decode files."""
    isolated.end_decoders()
    with pytest.MonkeyPatch.context() as patch:
        for name in libraries:
            (folder / f"{name}.py").write_text("raise ImportError(__name__)\n", encoding="utf-8")
            for loaded in [m for m in sys.modules if m.partition(".")[0] == name]:
                patch.delitem(sys.modules, loaded)
        patch.syspath_prepend(folder)
        try:
            yield
        finally:
            isolated.end_decoders()


WRITERS = {".tdms": write_tdms, ".mf4": write_mdf, ".mcap": write_mcap}
LIBRARY = {".tdms": "nptdms", ".mf4": "asammdf", ".mcap": "mcap_ros2"}
