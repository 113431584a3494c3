"""A curve in words and as data: what follows the coordinate, where it is largest, which sensor sees it."""

import numpy as np

from hallsym.diagnosis.coordinates import KNOTS, unit_of
from hallsym.diagnosis.curves import MEMORIES, Curve
from hallsym.diagnosis.policy import POLICY
from hallsym.diagnosis.record import Band, CurveShape, Statement
from hallsym.diagnosis.residual_table import ResidualTable, phase
from hallsym.diagnosis.words import percent, plain, shown
from hallsym.estimation.calibration import coverage_factor
from hallsym.log.quality.gains import listed
from hallsym.units import readable

FASTEST = 104
"""The most waves per period that are looked for: those of a stepper of 50 pole pairs and their neighbours."""


def described(r: ResidualTable, c: Curve, share: float, p: float, further: bool) -> Statement:
    """Return the statement that `share` of the excess follows a curve, a `further` one beside others."""
    coordinate, more = c.coordinate, "a further " if further else ""
    at = _most(c) if coordinate.ordered and coordinate.period is None else ""
    text = f"{more}{percent(share)} of the excess goes with {coordinate.name}{_form(r, c)}"
    text += f", {at}" if at else ""
    sensor = _mostly(r, c)
    text += f"; seen by {plain(sensor)} above all" if sensor else ""
    return Statement(coordinate.name, at, share, p, text)


def _form(r: ResidualTable, c: Curve) -> str:
    """Waves per period, ripples, or whether the gain follows the coordinate."""
    unit = c.coordinate.unit
    if c.coordinate.period is not None:
        waves, per = waves_of(r, c), "turn" if unit == "rad" else "period"
        return f", {listed([*map(str, waves)])} waves per {per}" if waves else ""
    if not c.fine:
        return _part(r, c)
    period = _period(c)
    return f", in ripples of {shown(period, unit)}" if period else ""


def _part(r: ResidualTable, c: Curve) -> str:
    """Whether the gain follows the coordinate or the reading as such."""
    if c.coordinate.of and c.coordinate.gain:
        k = len(c.coordinate.of)
        offset, gain = (float((c.offset[:, at : at + k] ** 2).sum()) for at in (0, k))
        parts = (c.offset**2).sum(axis=0).reshape(2, k).sum(axis=0)
        names = (readable(n)[2].capitalize() for n in c.coordinate.of)
        each = (f"{a} {percent(x)}" for a, x in zip(names, parts / parts.sum(), strict=True))
        what = _gain_or_offset(gain, offset)
        return f" ({what}{': ' if what else ''}{', '.join(each)})"
    if c.gain is None:
        return ""
    along = c.gain - c.gain.mean(axis=1, keepdims=True)
    level = c.offset - c.offset.mean(axis=1, keepdims=True)
    gain, offset = float((along**2).mean()), float((level**2).mean())
    what = _gain_or_offset(gain, offset)
    return f" ({what})" if what else ""


def _gain_or_offset(gain: float, offset: float) -> str:
    """Return which of two squares is meant above all, if one is."""
    least = POLICY.mostly * (gain + offset)
    return "the gain" if gain > least else "the offset" if offset > least else ""


def waves_of(r: ResidualTable, c: Curve) -> tuple[int, ...]:
    """Return the waves per period that hold most of the error which a curve makes of its own coordinate."""
    reference = next(x for x in r.references if c.coordinate.column == phase(x))
    error = (r.towards[reference] * c.predicted).sum(axis=0)
    return waves_per_period(c.values * (2 * np.pi / r.period[reference]), error)


def waves_per_period(at: np.ndarray, error: np.ndarray) -> tuple[int, ...]:
    """Return the waves per period of the sines that hold a tenth of an error's squares each.

    `at`: phase [rad]. The largest first, each fitted beside those before it: where half of a table's knots
    are held out, a wave has images at other orders. Of alike ones the slowest is meant.
    """
    waves = np.exp(-1j * np.outer(np.arange(1, FASTEST + 1), at))
    columns = [np.ones_like(at)]
    said: list[int] = []
    rest = error - error.mean()
    least = POLICY.minor * float(rest @ rest)
    while True:
        power = 2 * np.abs(waves @ rest) ** 2 / len(at)
        k = int(np.argmax(power >= (1 - POLICY.minor) * power.max()))
        if not power[k] > least:
            return tuple(said)
        said.append(k + 1)
        columns += [waves[k].real, waves[k].imag]
        X = np.array(columns).T
        rest = error - X @ np.linalg.lstsq(X, error, rcond=None)[0]


def _period(c: Curve) -> float | None:
    """Period of a fine map, where one line that no smooth curve follows holds most of its power."""
    waves = np.fft.rfft(c.offset - c.offset.mean(axis=1, keepdims=True), axis=1)  # per range
    power = (np.abs(waves) ** 2).sum(axis=0)
    k = int(np.argmax(power))
    near = power[k - 1 : k + 2]
    if 2 * k < KNOTS or near.sum() < POLICY.half * power.sum():
        return None
    centre = float(np.arange(k - 1, k - 1 + len(near)) @ near / near.sum())
    return float((c.at[1] - c.at[0]) * len(c.at) / centre)


def _most(c: Curve) -> str:
    """Where along the coordinate the predicted error is largest."""
    x = c.values if c.values.ndim == 2 else np.broadcast_to(c.values, c.predicted.shape)
    low, high = np.quantile(x, [0.005, 0.995])
    place, error = ((x - low) / (high - low)).ravel(), (c.predicted**2).ravel()
    parts = [
        error[mask].mean() if (mask := (place >= a) & (place < b)).any() else 0.0
        for a, b in ((-1, 0.25), (0.25, 0.75), (0.75, 2))
    ]
    unit = c.coordinate.unit
    ends = [shown(x, unit, sign=True) for x in (low, high)]
    span, (lower, middle, upper) = f"({ends[0]} to {ends[1]})", parts
    if min(lower, upper) > 2 * middle:
        return f"most at the ends of the range {span}"
    if upper > 2 * max(lower, middle):
        return f"most at the upper end, near {ends[1]}"
    if lower > 2 * max(middle, upper):
        return f"most at the lower end, near {ends[0]}"
    if middle > 2 * max(lower, upper):
        return f"most in the middle of the range {span}"
    return f"all over the range {span}"


def _mostly(r: ResidualTable, c: Curve) -> str | None:
    """Return the sensor that sees most of a curve, if there is one."""
    seen = (c.predicted**2).sum(axis=1) * np.diag(r.precision)
    k = int(np.argmax(seen))
    return r.channels[k] if seen[k] > POLICY.mostly * seen.sum() else None


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
