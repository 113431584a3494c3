"""What a person reads of errors along a coordinate by cause."""

from collections.abc import Iterator

from hallsym.report.tables import grid, heads
from hallsym.uncertainty import ErrorModel
from hallsym.units import fitting, readable


def errors_text(found: ErrorModel) -> str:
    """Return what `hallsym tolerances --along` prints: errors by cause, and what makes how many waves."""
    return "\n".join([_first(found), "", error_table(found), *_waves(found)])


def span(found: ErrorModel) -> tuple[float, float, float, str, str]:
    """Return first place, end of the range, factor, unit and name of the coordinate that moves."""
    column, at = found.coordinate, found.causes[0][2].at
    low, high = float(at[0]), float(at[0] + (at[1] - at[0]) * len(at))
    factor, unit, name = readable(column, found.model.period)
    if unit != "deg":
        factor, unit = fitting(column.rpartition("_")[2], max(abs(low), abs(high)))
    return low, high, factor, unit, name


def _first(found: ErrorModel) -> str:
    low, high, factor, unit, name = span(found)
    shown = ((*readable(c, found.model.period), v) for c, v in found.at.items())
    rest = "".join(f", {n} = {v * f:.6g} {u}" for f, u, n, v in shown)
    return (
        f"{found.model.name}: error (decoded less true) over {name} = {factor * low:.6g} to "
        f"{factor * high:.6g} {unit}{rest}; decoder: {found.decoder}, nominal values, no noise"
    )


def error_table(found: ErrorModel) -> str:
    """Return one line per cause and coordinate of the pose."""
    *_, factor, unit, name = span(found)
    pose, period, place = found.model.pose, found.model.period, f"at {name} [{unit}]"
    rows = [["cause", "error", "mean", "rms", "largest", place, "least", place, "waves"]]
    for cause, _, errors in found.causes:
        for k, column in enumerate(pose):
            f = readable(column, period)[0]
            (high, there), (low, here) = errors.extremes(k)
            numbers = (errors.error[k].mean(), errors.rms[k], high, low)
            mean, rms, most, least = ("0" if abs(v * f) < SHOWN else f"{v * f:.4g}" for v in numbers)
            ends = [most, f"{there * factor:.4g}", least, f"{here * factor:.4g}"]
            label = cause if k == 0 else ""
            rows.append([label, *heads([column], period), mean, rms, *ends, str(errors.waves[k])])
    return grid(rows, left=2)


SHOWN = 1e-4
"""Least error shown [um, urad, mdeg]: a decoder that has converged only rounds below it."""


def _waves(found: ErrorModel) -> Iterator[str]:
    expected = found.expected_waves
    if not expected:
        return
    low, high, factor, unit, name = span(found)
    yield ""
    yield f"causes by the waves of their error per {factor * (high - low):.6g} {unit} of {name}"
    rows = [["waves", f"period [{unit}]", "effects"]]
    for n, effects in expected.items():
        if n:
            rows.append([str(n), f"{factor * (high - low) / n:.4g}", ", ".join(effects)])
    yield grid(rows, left=3)
