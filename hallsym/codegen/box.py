"""The calibrated box: the inputs over which generated code answers with status 0."""

from collections.abc import Collection, Mapping

import numpy as np

from hallsym.codegen.decoupler import Box, short
from hallsym.errors import InputError, require
from hallsym.estimation.calibration import Fit
from hallsym.log.columns import limit_of

NEARLY = 0.9
"""Ends whose magnitudes differ by less than this ratio become one symmetric limit, the smaller of the two."""


def box_of(
    fit: Fit, given: Mapping[str, tuple[float, float]] | None = None, entries: Collection[str] = ()
) -> Box:
    """Return the box of a calibration: what its log recorded, `given` columns in its place.

    `entries`: names in the table of code that shall stay as it is. A range that became lopsided is cut to the
    one limit that such code has for both ends, one that became symmetric keeps two ends. Raises `InputError`
    for unknown columns, empty ranges, and a calibration that knows no ranges.
    """
    model = fit.model
    columns = (*model.pose, *model.state, *model.channels)
    ends: dict[str, tuple[float, float]] = {}
    named = {c: (f"limit_{short(c)}", f"low_{short(c)}") for c in (*model.channels, *model.state)}
    one_limit = {c: one in entries for c, (one, two) in named.items() if one in entries or two in entries}
    span = fit.log.span
    for column, reference in zip((*model.pose, *model.state), (*model.references, *model.state), strict=True):
        if column in model.period and reference not in model.absolute:  # what repeats is known all round
            ends[column] = (-model.period[column], model.period[column])
        elif reference in span:
            low, high = span[reference]
            if not (np.isfinite([low, high]).all() and low <= high):
                raise InputError(
                    f"The calibration says that {reference} was recorded from {low:g} to {high:g}, which is "
                    "no range: fit the log again."
                )
            ends[column] = _rounded(column, low, high, one_limit.get(column))
    for column, (low, high) in (given or {}).items():
        require(column in columns, "A range", f"that of one of {', '.join(columns)}", column, columns)
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"The range of {column} must go from the lesser to the greater value, finite.")
        limit = limit_of(column)
        if limit and high - low > limit.span:
            raise InputError(
                f"The range of {column}, {low:g} to {high:g}, is wider than {limit.what} ({limit.span:g} in "
                "SI); check its unit: --range z_um=-200:200."
            )
        ends[column] = (float(low), float(high))
        if low != -high:  # what is asked for is not cut
            one_limit.pop(column, None)
    for column in (*model.pose, *model.state):
        if column not in ends:
            raise InputError(
                f"The calibration does not say over which {column} it was recorded (it was saved by an older "
                f"hallsym); fit the log again, or give --range {column}=LOW:HIGH."
            )
    return Box(ends, one_limit)


def shortened(fit: Fit, box: Box) -> list[str]:
    """Return a sentence for each state column of which the box leaves a part of what was recorded out."""
    out, span = [], fit.log.span
    for column in fit.model.state:
        if box.one_limit.get(column) and column in span:
            (low, high), most = span[column], box.ends[column][1]
            if NEARLY * max(-low, high) > most:
                out.append(
                    f"{column} was recorded from {low:.3g} to {high:.3g}, but the code that is there has one "
                    f"limit for both ends: {most:.3g}. The status tells what lies beyond; without "
                    "--params-only both ends are kept."
                )
    return out


def _rounded(column: str, low: float, high: float, one_limit: bool | None) -> tuple[float, float]:
    """Recorded ends to three digits; as one limit if nearly symmetric, or if code that is there has one."""
    low, high = float(f"{low:.3g}"), float(f"{high:.3g}")
    around = low < 0 < high
    if one_limit and not around:
        raise InputError(
            f"{column} was recorded from {low:g} to {high:g}, without zero, and the code that is there has "
            "one limit for both ends; generate the folder again with --force."
        )
    if one_limit or (one_limit is None and around and min(-low, high) >= NEARLY * max(-low, high)):
        return -min(-low, high), min(-low, high)
    if low == high:  # a column that never moved: some room for its noise
        room = max(abs(low) * 1e-3, 1e-9)
        return low - room, high + room
    return low, high
