"""Which tables code accepts: least and greatest value of each entry, as `decoupler_check()` compares them.

They are as wide as finite results allow: an interval evaluation of all steps, over every table within them
and every input within the limits of such a table, stays below the largest number, divides by nothing that may
be zero and takes whole numbers of what is one. So every accepted table gives finite numbers. Gains stay away
from zero by their ends alone: the largest terms of a gain at the largest limits leave a share of its least
value at rest.
"""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import ceil, floor, log10, prod
from typing import Any

import numpy as np

from hallsym.codegen.bounds import LEAST_GAIN, enclosed_step
from hallsym.codegen.decoupler import Decoupler, Margin, Whole, short
from hallsym.codegen.intervals import Enclosure
from hallsym.errors import InputError

Ends = Mapping[str, tuple[float, float]]
"""Least and greatest value by entry or array."""
WIDE, NARROW = tuple(range(10, 0, -1)), (0.5, 0.25, 0.125, 0.0625, 0.03125)
"""Powers of two by which entries may differ from those of the calibration, the widest that is finite."""
LEAST_LIMIT = 2.0**-10
"""Share of a limit of the calibration below which a range is empty, or -0."""
MOST = 2.0**-8 * float(np.finfo(np.float32).max)
"""Number that no step exceeds: a share of the largest one, so that the rounding of each step is counted."""
DIGITS = 4
"""Of the ends of what a gain is made of."""
STEPS = 2.0**0.125
"""Ratio between the ratios that are tried for gains."""


def kept_ends(before: Ends | None, values: Mapping[str, Sequence[float]]) -> Ends | None:
    """Return the ends of code that shall stay as it is, if its table has these entries.

    Raises `InputError` where it does not accept the values of one.
    """
    if before is None or before.keys() != values.keys():  # of another layout is refused as such
        return None
    for name, own in values.items():
        low, high = before[name]
        if not (low <= min(own) and max(own) <= high):
            raise InputError(
                f"The calibration's {name}, {own[0]:.3g}, is not within {low:.3g} to {high:.3g}, "
                "which the code in the folder accepts; generate the folder again with --force."
            )
    return before


def accepted(d: Decoupler) -> dict[str, tuple[float, float]]:
    """Return least and greatest value of each number and array of the table.

    Raises `InputError` where nothing bounds the results.
    """
    if widest := any_accepted(d):
        return widest
    raise InputError(
        f"Nothing bounds what the C of model {d.model.name} computes of tables like this one: its numbers "
        "spread too far; give a smaller box with --range."
    )


def any_accepted(d: Decoupler) -> dict[str, tuple[float, float]] | None:
    """Return the widest ends of which no step gives more than `MOST`, if there are any."""
    for sizes, powers in ((_by_unit(d), WIDE), (_by_form(d), (*WIDE, *NARROW)), (None, NARROW)):
        tried = [_within(d, 2.0**power, sizes) for power in powers]
        good = finite(d, tried)
        if good.any():
            return tried[int(good.argmax())]
    return None


def accepted_of(record: Mapping[str, Any]) -> Ends | None:
    """Return the ends that the record of a generated table says; None where it says none."""
    parts, found = [record.get(name, []) for name in ("parameters", "arrays")], {}
    if not all(isinstance(part, list) for part in parts):
        return None
    for entry in (entry for part in parts for entry in part):
        ends: list[Any] = [entry.get(k) for k in ("least", "greatest")] if isinstance(entry, dict) else [None]
        if not all(isinstance(end, int | float) for end in ends):
            return None
        low, high = map(float, ends)
        found[str(entry.get("name"))] = (low, high)
    return found or None


def _by_unit(d: Decoupler) -> dict[str, float]:
    """Return for each entry the largest of its unit, limits too."""
    sizes: dict[str, float] = {}
    for e in (*d.table, *d.limits):
        sizes[e.unit] = max(sizes.get(e.unit, 0.0), abs(e.value))
    return {e.name: sizes[e.unit] or 1.0 for e in d.table}


def _by_form(d: Decoupler) -> dict[str, float]:
    """Return for each entry the largest of those with its name but for columns: all offsets, for example."""
    columns = "|".join(sorted((re.escape(short(c)) for c in (*d.inputs, *d.pose)), key=len, reverse=True))
    form = {e.name: re.sub(rf"(?<![a-z0-9])({columns})(?![a-z0-9])", "", e.name) for e in d.table}
    sizes: dict[str, float] = {}
    for e in d.table:
        sizes[form[e.name]] = max(sizes.get(form[e.name], 0.0), abs(e.value))
    return {e.name: sizes[form[e.name]] for e in d.table}


def _within(d: Decoupler, ratio: float, sizes: Mapping[str, float] | None) -> dict[str, tuple[float, float]]:
    """Return ends that leave each entry a ratio: both signs of the larger of its own and a given size.

    Its own sign alone without `sizes`.
    """
    out, rests, digits = {}, {m.rest for m in d.margins}, 1 if ratio >= 2 else 3
    for e in d.table:
        size = abs(e.value)
        if e.holds == "value":
            out[e.name] = (e.value, e.value)
        elif e.holds == "share":
            out[e.name] = (0.0, 1.0)
        elif sizes is None or e.name in rests or e.holds == "sign":
            ends = _outward(size / ratio, size * ratio, digits)
            out[e.name] = ends if e.value >= 0 else (-ends[1], -ends[0])
        else:
            out[e.name] = _both(ratio * max(size, sizes[e.name]), digits)
    for column in d.inputs:
        name, ends, period = short(column), d.ends(column), d.model.period.get(column, np.inf)
        most = max(map(abs, ends))
        far = min(ratio * most, max(period, most))
        if d.box.symmetric(column):
            least, greatest = _outward(LEAST_LIMIT * ends[1], far, digits)
            out[f"limit_{name}"] = least, greatest if far < period else far
        elif sizes is None:
            room = (ratio - 1) * most
            out |= {
                f"{side}_{name}": (v - room, v + room) for side, v in zip(("low", "high"), ends, strict=True)
            }
        else:
            out[f"low_{name}"] = out[f"high_{name}"] = _both(far, digits) if far < period else (-far, far)
    for a in d.arrays:
        size = max(map(abs, a.values))
        out[a.name] = (-32768.0, 32767.0) if a.integers else _both(ratio * (size or 1.0), digits)
    offsets = {e.name: (-2 * d.known(c), 2 * d.known(c)) for e, c in zip(d.offsets, d.pose, strict=True)}
    return out | dict(_of_gains(d, ratio)) | offsets


def _of_gains(d: Decoupler, ratio: float) -> Iterator[tuple[str, tuple[float, float]]]:
    """Yield the ends of gains at rest, of their terms, and of the limits of what these are multiplied by.

    Gains and limits may differ from the calibration by one ratio, terms by its cube or more: the widest up to
    `ratio` for which the terms of each gain take no more than a share of it. Terms are what recalibrations
    move most. A small one may be as large as the mean of its gain's.
    """
    values, gains, sizes = {e.name: abs(e.value) for e in d.table}, [m for m in d.margins if m.terms], {}
    reach = {c: max(map(abs, d.ends(c))) for m in gains for _, columns in m.terms for c in columns}
    for m in gains:
        own = {e: values[e] * prod(reach[c] for c in columns) / values[m.rest] for e, columns in m.terms}
        total = sum(own.values())
        least = min(total or LEAST_GAIN, 1 - LEAST_GAIN - total) / len(own)
        sizes[m.rest] = {e: max(size, least) for e, size in own.items()}

    def taken(m: Margin, wide: float) -> float:
        return sum(sizes[m.rest][e] * wide ** len(columns) for e, columns in m.terms)

    wide = ratio
    while wide > 1.0 and any(wide**4 * taken(m, wide) > 1 - LEAST_GAIN for m in gains):
        wide = max(wide / STEPS, 1.0)
    for c, most in reach.items():
        name, far = short(c), _rounded(wide * most, ceil, DIGITS)
        if d.box.symmetric(c):
            yield f"limit_{name}", (_rounded(LEAST_LIMIT * most, floor, DIGITS), far)
        else:
            yield from ((f"{side}_{name}", (-far, far)) for side in ("low", "high"))
    for m in gains:
        rest = _outward(values[m.rest] / wide, values[m.rest] * wide, DIGITS)
        positive = next(e.value for e in d.table if e.name == m.rest) > 0
        yield m.rest, rest if positive else (-rest[1], -rest[0])
        free = (1 - LEAST_GAIN) * values[m.rest] / wide / taken(m, wide)
        for e, columns in m.terms:
            far = prod(reach[c] for c in columns)
            most = max(free * sizes[m.rest][e] / far, values[e]) if far else 0.0
            yield e, _both(most, DIGITS)


def _outward(least: float, greatest: float, digits: int) -> tuple[float, float]:
    """Return positive ends rounded outwards to few digits: so they outlast a small recalibration."""
    return _rounded(least, floor, digits), _rounded(greatest, ceil, digits)


def _both(size: float, digits: int) -> tuple[float, float]:
    most = _rounded(size, ceil, digits)
    return -most, most


def _rounded(value: float, to: Callable[[float], int], digits: int) -> float:
    power = floor(log10(value)) - digits + 1 if value > 0 else 0
    return float(f"{to(value / 10.0**power)}e{power}")


def finite(d: Decoupler, ends: Sequence[Ends]) -> np.ndarray:
    """Whether all steps give numbers of less than `MOST` of every table within some ends, (ends,)."""
    sides = {name: np.array([own[name] for own in ends]).T for name in ends[0]}
    known = {name: Enclosure(*pair) for name, pair in sides.items()}
    good = np.ones(len(ends), bool)
    for column in d.inputs:
        name = short(column)
        if d.box.symmetric(column):
            high = sides[f"limit_{name}"][1]
            known[name] = Enclosure(-high, high)
        else:
            known[name] = Enclosure(sides[f"low_{name}"][0], sides[f"high_{name}"][1])
    for step in d.steps:
        every, last = enclosed_step(step, known), step.graph.results[0]
        if isinstance(step, Whole):
            good &= (known[step.name].low > -1) & (known[step.name].high < 2.0**32)
        for possible, values in every:
            for k, e in enumerate(values):  # not of one that is not a number either
                if k != last or step.most is None:  # else the value alone may be more
                    good &= ~possible | (abs(e) < MOST)
    return good
