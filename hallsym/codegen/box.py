"""The calibrated box: the inputs over which generated code answers with status 0."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hallsym.codegen.entries import Entry, short, unit
from hallsym.errors import InputError, nearest
from hallsym.estimation.calibration import Fit
from hallsym.log.limits import limit_of

NEARLY = 0.9
"""Ends whose magnitudes differ by less than this ratio become one symmetric limit, the smaller of the two."""


@dataclass(frozen=True)
class Box:
    """Least and greatest value of each column, in SI: state, pose and, where given, readings."""

    ends: Mapping[str, tuple[float, float]]

    def reach(self) -> dict[str, float]:
        """Return the largest magnitude of each column."""
        return {column: max(abs(low), abs(high)) for column, (low, high) in self.ends.items()}

    def symmetric(self, column: str) -> bool:
        """Whether one limit says it."""
        low, high = self.ends[column]
        return low == -high


def box_of(fit: Fit, given: Mapping[str, tuple[float, float]] | None = None) -> Box:
    """Return the box of a calibration: what its log recorded, `given` columns in its place.

    Raises `InputError` for unknown columns, empty ranges, and a calibration that knows no ranges.
    """
    model = fit.model
    columns = (*model.pose, *model.state, *model.channels)
    ends: dict[str, tuple[float, float]] = {}
    span = fit.log.get("span", {})
    for column, reference in zip((*model.pose, *model.state), (*model.references, *model.state), strict=True):
        if column in model.period and reference not in model.absolute:  # what repeats is known all round
            ends[column] = (-model.period[column], model.period[column])
        elif reference in span:
            ends[column] = _rounded(*_recorded(reference, *span[reference]))
    for column, (low, high) in (given or {}).items():
        if column not in columns:
            raise InputError(
                f"A range belongs to one of {', '.join(columns)}; instead received {column!r}"
                f"{nearest(column, list(columns))}."
            )
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"The range of {column} must go from the lesser to the greater value, finite.")
        limit = limit_of(column)
        if limit and high - low > limit.span:
            raise InputError(
                f"The range of {column}, {low:g} to {high:g}, is wider than {limit.what} ({limit.span:g} in "
                "SI); check its unit: --range z_um=-200:200."
            )
        ends[column] = (float(low), float(high))
    for column in (*model.pose, *model.state):
        if column not in ends:
            raise InputError(
                f"The calibration does not say over which {column} it was recorded (it was saved by an older "
                f"hallsym); fit the log again, or give --range {column}=LOW:HIGH."
            )
    return Box(ends)


def _recorded(column: str, low: float, high: float) -> tuple[float, float]:
    if not (np.isfinite([low, high]).all() and low <= high):
        raise InputError(
            f"The calibration says that {column} was recorded from {low:g} to {high:g}, which is no range: "
            "fit the log again."
        )
    return low, high


def _rounded(low: float, high: float) -> tuple[float, float]:
    """Recorded ends to three digits; nearly symmetric ones as one limit."""
    low, high = float(f"{low:.3g}"), float(f"{high:.3g}")
    if low < 0 < high and min(-low, high) >= NEARLY * max(-low, high):
        return -min(-low, high), min(-low, high)
    if low == high:  # a column that never moved: some room for its noise
        room = max(abs(low) * 1e-3, 1e-9)
        return low - room, high + room
    return low, high


def limits(inputs: Sequence[str], box: Box) -> tuple[Entry, ...]:
    """Return the table entries of the ends of each input: one limit where it is symmetric."""
    out = []
    for column in inputs:
        low, high = box.ends[column]
        if box.symmetric(column):
            out.append(Entry(f"limit_{short(column)}", high, unit(column), f"largest |{column}| of the box"))
        else:
            out.append(Entry(f"low_{short(column)}", low, unit(column), f"least {column} of the box"))
            out.append(Entry(f"high_{short(column)}", high, unit(column), f"greatest {column} of the box"))
    return tuple(out)
