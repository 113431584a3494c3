"""Report of sorted sensors and of the sets chosen for arrays, and their tables as files."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from hallsym.errors import counted
from hallsym.files import atomic_write, write_json
from hallsym.output import csv_text, percent
from hallsym.report.content import Block, Content, Section, Table
from hallsym.report.results.shared import few
from hallsym.report.tables import cells, heads
from hallsym.report.words import number
from hallsym.sorting import Matching, Sorting
from hallsym.units import fitting

MOST_BINS, MOST_SETS = 40, 10
"""Rows that a terminal shows; files and JSON have all."""


def sorting_content(found: Sorting, matching: Matching | None = None) -> Content:
    """Return the report of sorted sensors: gains, bins, repeats, and the sets chosen of them."""
    expected, spread = found.expected_wrong
    sensors = counted(len(found.sensors), "sensor")
    share = percent(expected / len(found.sensors), 1)
    gains = (
        f"gain: median {number(np.median(found.gain), 6)} {found.unit}, from"
        f" {100 * (found.relative.min() - 1):+.3g} to {100 * (found.relative.max() - 1):+.3g} % of"
        f" {number(found.nominal, 6)}; standard uncertainty (1 sigma) of one"
        f" {_percent(float(np.median(found.std)) / found.nominal)}"
    )
    wrong = f"in a wrong bin: {expected:.0f} +- {spread:.0f} (1 sigma) sensors expected ({share})"
    notes = [f"note: {note}" for note in (*found.notes, *(matching.notes if matching else ()))]
    return Content(
        f"Sensors of {found.source}",
        f"{found.source}: {sensors} sorted into {counted(len(found.bins), 'bin')}"
        + (f"; {_chosen(matching)}." if matching else "."),
        [
            Section("bins", "Bins", [*bin_blocks(found), wrong, *_bench(found)]),
            Section("sets", "Sets", [*(matching_blocks(matching) if matching else []), *notes]),
        ],
        [gains],
        columns=_columns(found),
    )


def _columns(found: Sorting) -> dict[str, Any]:
    """Return what is known of each sensor, in the units of its gain and readings."""
    return {
        "sensor": found.sensors, "gain": found.gain, "gain_std": found.std, "offset": found.offset,
        "bin": found.bin, "wrong_bin_probability": found.wrong,
    }  # fmt: skip


def bin_blocks(found: Sorting) -> list[Block | str]:
    """Return the bins with what is in them; the fullest where there are many."""
    items = sorted(found.bins.items(), key=lambda item: -item[1])[:MOST_BINS]
    rows = []
    for k, n in sorted(items):
        middle, half = 100 * k * found.width, 50 * found.width
        ends = f"{middle - half:+.3g} to {middle + half:+.3g}"
        rows.append([_change(k), ends, str(n), f"{found.wrong[found.bin == k].sum():.1f}"])
    rest = len(found.bins) - len(items)
    table = Table(["bin", "gain [%]", "sensors", "wrong, expected"], rows, "bins")
    return [table, *([f"and {counted(rest, 'bin')} with fewer sensors"] if rest > 0 else [])]


def _bench(found: Sorting) -> Iterator[Block | str]:
    if found.drift is not None:
        yield f"drift: {_percent(float(np.ptp(found.drift)))} in all, taken out by the reference sensor"
    if r := found.repeats:
        yield (
            f"repeatability (1 sigma): {_percent(found.repeatability)} of one measurement;"
            f" {counted(len(r.first), 'sensor')} measured again, {100 * r.drift:+.3f} % on average"
        )
        rows = []
        for k, (n, e) in r.changes(found.width).items():
            rows.append([_change(k), str(n), f"{e:.1f}" if np.isfinite(e) else ""])
        yield Table(["change of bin", "sensors", "expected"], rows, "changes of bin")
    if found.unsorted:
        yield f"not read in two fields, and not sorted: {few(found.unsorted)}"


def matching_blocks(found: Matching) -> list[Block | str]:
    """Return the ways of choosing sets beside each other, and the first of the chosen sets."""
    best = "; optimal" if found.optimal else ""
    factor, unit = _unit(found, found.floor)
    beside = f"matched sets are {number(found.gain_over_bins)} times better than bins alone"
    beside = beside if len(found.bins.sets) else "no bin holds enough sensors for a set"
    return [
        f"sets of {len(found.places)} for {found.model.name}, whose decoder knows the common gain{best}",
        way_table(found),
        f"the uncertainty of the gains alone makes {number(found.floor * factor)} {unit} rms; {beside}",
        *set_blocks(found),
    ]


def _chosen(found: Matching) -> str:
    """Return how many sets were chosen, and the error to expect of them."""
    error = found.expected(found.matched)
    factor, unit = _unit(found, error)
    sets = counted(len(found.places), "sensor")
    return (
        f"{counted(len(found.matched.sets), 'matched set')} of {sets} for {found.model.name}: an error of"
        f" {number(error * factor)} {unit} rms is expected"
    )


def way_table(found: Matching) -> Table:
    """Return rms and peak errors of the pose by way of choosing."""
    factor, unit = _unit(found, max(w.overall for w in found.ways if len(w.sets)))
    pose, period = found.model.pose, found.model.period
    head = ["way", "sets", f"rms [{unit}]", f"expected [{unit}]", *heads(pose, period, "peak")]
    rows = []
    for way in found.ways:
        if not len(way.sets):
            rows.append([way.name, "0", *[""] * (2 + len(pose))])
            continue
        sizes = [number(value * factor) for value in (way.overall, found.expected(way))]
        peaks = cells(way.pose_peak.max(axis=0), pose, period)
        rows.append([way.name, str(len(way.sets)), *sizes, *peaks])
    return Table(head, rows, "errors by way of choosing")


def set_blocks(found: Matching) -> list[Block | str]:
    """Return the first sets: sensor by place, common gain and rms error."""
    way = found.matched
    factor, unit = _unit(found, float(way.rms.max()))
    places = found.places[:6]
    more = ["..."] if len(found.places) > len(places) else []
    head, rows = ["set", *places, *more, "gain", f"rms [{unit}]"], []
    for j, (row, gain, rms) in enumerate(zip(way.sets[:MOST_SETS].tolist(), way.gain, way.rms, strict=False)):
        names = [found.sensors[i] for i in row[: len(places)]]
        rows.append([str(j + 1), *names, *more, f"{gain:.4f}", number(rms * factor)])
    rest = len(way.sets) - MOST_SETS
    more = [f"and {counted(rest, 'set')} more; -o FILE.csv lists all"] if rest > 0 else []
    return [Table(head, rows, "the first sets"), *more]


def save_table(path: str, found: Sorting, matching: Matching | None = None) -> None:
    """Write every sensor with gain, bin and, where sets were chosen, set and place; JSON holds everything."""
    if Path(path).suffix == ".json":
        record = found.to_dict() | ({"matching": matching.to_dict()} if matching else {})
        write_json(path, record)
        return
    place: dict[int, tuple[int, str]] = {}
    if matching:
        for j, row in enumerate(matching.matched.sets.tolist()):
            place |= {i: (j + 1, where) for i, where in zip(row, matching.places, strict=True)}
    columns = _columns(found)
    rows = [[*columns, *(("set", "place") if matching else ())]]
    for i, (sensor, gain, std, offset, k, wrong) in enumerate(zip(*columns.values(), strict=True)):
        cells = [sensor, f"{gain:.9g}", f"{std:.3g}", f"{offset:.9g}", k, f"{wrong:.4f}"]
        rows.append([*cells, *(place.get(i, ("", "")) if matching else ())])
    atomic_write(path, csv_text(rows))


def _change(bins: int) -> str:
    return f"{bins:+d}" if bins else "0"


def _percent(value: float) -> str:
    return f"{number(100 * value, 2)} %"


def _unit(found: Matching, largest: float) -> tuple[float, str]:
    """Return factor and unit of rms errors up to `largest`: degrees where the pose is a periodic angle."""
    return fitting(found.unit, largest, turns=any(c in found.model.period for c in found.model.pose))
