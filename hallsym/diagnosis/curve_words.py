"""A curve in words and as data: what follows the coordinate, and which sensor sees it."""

import numpy as np

from hallsym.diagnosis.coordinates import unit_of
from hallsym.diagnosis.curves import MEMORIES, Curve
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.record import Band, CurveShape, Statement
from hallsym.diagnosis.residual_table import ResidualTable, phase
from hallsym.diagnosis.words import percent, plain
from hallsym.estimation.calibration import coverage_factor
from hallsym.units import readable


def described(r: ResidualTable, c: Curve, share: float, p: float, further: bool) -> Statement:
    """Return the statement that `share` of the excess follows a curve, a `further` one beside others."""
    text = f"{'a further ' if further else ''}{percent(share)} of the excess goes with {c.coordinate.name}"
    text += _part(c, r.policy)
    seen = (c.predicted**2).sum(axis=1) * np.diag(r.precision)
    k = int(np.argmax(seen))
    if seen[k] > r.policy.half * seen.sum():
        text += f"; seen by {plain(r.channels[k])} above all"
    return Statement(c.coordinate.name, "", share, p, text)


def _part(c: Curve, policy: Policy) -> str:
    """Whether the gain or the offset follows the coordinate above all, and which part of several."""
    names = [readable(n)[2].capitalize() for n in c.coordinate.of] if c.coordinate.gain else []
    if names:
        offset, gain = (c.offset**2).sum(axis=0).reshape(2, len(names))
        parts = (offset + gain) / (offset + gain).sum()
        each = ", ".join(f"{a} {percent(x)}" for a, x in zip(names, parts, strict=True))
    elif c.gain is not None:
        offset, gain = (np.array(_size(curve)) for curve in (c.offset, c.gain))
        each = ""
    else:
        return ""
    least = policy.half * (gain.sum() + offset.sum())
    what = "the gain" if gain.sum() > least else "the offset" if offset.sum() > least else ""
    said = ": ".join(filter(None, (what, each)))
    return f" ({said})" if said else ""


# -- a curve as data ---------------------------------------------------------------------------------------

NAMES = {"sensed": "reading_m", "rate": "reading_rate_m_s"}
"""What JSON calls the columns that every sensor has for itself."""


def shape(c: Curve, r: ResidualTable) -> CurveShape:
    """Return a curve as data; the bands at 95 % come from runs left out in turn."""
    value, spread, scale, gain = c.offset, c.spread, 1.0, False
    if c.gain is not None and c.gain_spread is not None and _size(c.gain) > _size(c.offset):
        value, spread, scale, gain = c.gain, c.gain_spread, c.scale, True
    periodic = {phase(x): x for x in r.references}
    column = periodic.get(c.coordinate.column, c.coordinate.column)
    wide = coverage_factor(np.inf) * spread
    bands = (np.stack([value, value - wide, value + wide], axis=1) / scale).tolist()
    return CurveShape(
        coordinate=c.coordinate.name,
        line=c.coordinate.ordered,
        column=NAMES.get(column, column),
        unit=c.coordinate.unit,
        kind="gain" if gain else "offset",
        value_unit="1" if gain else unit_of(r.channels[0]),
        grid=tuple(c.at.tolist()),
        labels=_labels(c, r),
        readings={channel: Band(*map(tuple, each)) for channel, each in zip(r.channels, bands, strict=True)},
    )


def _labels(c: Curve, r: ResidualTable) -> tuple[str, ...] | None:
    """Names of the features of a coordinate that is no place on a line."""
    if c.coordinate.memory:
        return tuple(f"play {w:g} rms" for w in MEMORIES)
    names = [readable(n)[2] for n in c.coordinate.of]
    if c.coordinate.gain and names:
        return tuple(f"{what}, {n.capitalize()}" for what in ("offset", "gain") for n in names)
    return tuple(readable(n)[2].removesuffix("_ref") for n in r.references) if names else None


def _size(curve: np.ndarray) -> float:
    """Mean square of a curve about its mean: a constant is the model's own."""
    return float(((curve - curve.mean(axis=1, keepdims=True)) ** 2).mean())
