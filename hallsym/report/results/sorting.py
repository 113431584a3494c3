"""Report of sorted sensors and of the sets chosen for arrays, and their tables as files."""

from collections.abc import Iterator

import numpy as np

from hallsym.errors import counted, few
from hallsym.files import atomic_write
from hallsym.output import csv_text, percent
from hallsym.report.content import Block, Content, Section, Table
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
        f" {number(100 * float(np.median(found.std)) / found.nominal, 2)} %"
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
        columns=found.columns,
    )


def bin_blocks(found: Sorting) -> Iterator[Block | str]:
    """Yield the bins with what is in them; the fullest where there are many."""
    items = sorted(found.bins.items(), key=lambda item: -item[1])[:MOST_BINS]
    rows = []
    for k, n in sorted(items):
        middle, half = 100 * k * found.width, 50 * found.width
        ends = f"{middle - half:+.3g} to {middle + half:+.3g}"
        rows.append([_change(k), ends, str(n), f"{found.wrong[found.bin == k].sum():.1f}"])
    yield Table(["bin", "gain [%]", "sensors", "wrong, expected"], rows, "bins")
    if len(found.bins) > MOST_BINS:
        yield f"and {counted(len(found.bins) - MOST_BINS, 'bin')} with fewer sensors"


def _bench(found: Sorting) -> Iterator[Block | str]:
    if found.drift is not None:
        yield f"drift: {number(100 * np.ptp(found.drift), 2)} % in all, taken out by the reference sensor"
    if r := found.repeats:
        yield (
            f"repeatability (1 sigma): {number(100 * found.repeatability, 2)} % of one measurement;"
            f" {counted(len(r.first), 'sensor')} measured again, {100 * r.drift:+.3f} % on average"
        )
        changes = r.changes(found.width).items()
        rows = [[_change(k), str(n), f"{e:.1f}" if np.isfinite(e) else ""] for k, (n, e) in changes]
        yield Table(["change of bin", "sensors", "expected"], rows, "changes of bin")
    if found.unsorted:
        yield f"not read in two fields, and not sorted: {few(found.unsorted)}"


def matching_content(found: Matching) -> Content:
    """Return the report of sets alone."""
    rows = [(k + 1, *one) for k, row in enumerate(found.chosen()) for one in row["sensors"].items()]
    return Content(
        f"Sets for {found.model.name}",
        f"{_chosen(found)}.",
        first=[*matching_blocks(found), *(f"note: {note}" for note in found.notes)],
        columns={key: [row[k] for row in rows] for k, key in enumerate(("set", "place", "sensor"))},
    )


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
        *_first_sets(found),
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


def _first_sets(found: Matching) -> Iterator[Block | str]:
    way = found.matched
    factor, unit = _unit(found, float(way.rms.max()))
    places = found.places[:6]
    more = ["..."] if len(found.places) > len(places) else []
    head, rows = ["set", *places, *more, "gain", f"rms [{unit}]"], []
    for j, (row, gain, rms) in enumerate(zip(way.sets[:MOST_SETS].tolist(), way.gain, way.rms, strict=False)):
        names = [found.sensors[i] for i in row[: len(places)]]
        rows.append([str(j + 1), *names, *more, f"{gain:.4f}", number(rms * factor)])
    yield Table(head, rows, "the first sets")
    if len(way.sets) > MOST_SETS:
        yield f"and {counted(len(way.sets) - MOST_SETS, 'set')} more; -o FILE.csv lists all"


def save_table(path: str, found: Sorting, matching: Matching | None = None) -> None:
    """Write every sensor with gain, bin and, where sets were chosen, set and place, as CSV."""
    columns = found.columns
    if matching:
        columns |= {"set": [""] * len(found.sensors), "place": [""] * len(found.sensors)}
        for j, row in enumerate(matching.matched.sets.tolist()):
            for i, where in zip(row, matching.places, strict=True):
                columns["set"][i], columns["place"][i] = j + 1, where
    atomic_write(path, csv_text([[*columns], *zip(*columns.values(), strict=True)]))


def _change(bins: int) -> str:
    return f"{bins:+d}" if bins else "0"


def _unit(found: Matching, largest: float) -> tuple[float, str]:
    """Return factor and unit of rms errors up to `largest`: degrees where the pose is a periodic angle."""
    return fitting(found.unit, largest, turns=any(c in found.model.period for c in found.model.pose))
