"""Where the gap lies: which share of the excess goes with a coordinate, a sensor, a frequency, a run.

Coordinates are taken one after the other, the one that explains most of what is still there first, so that
shares add up to at most the whole and nothing is said twice. Each share is counted on runs that the curve was
not fitted on; each p-value takes runs (or stretches of few runs) as blocks and counts how much was tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.chance import beyond
from hallsym.diagnosis.record import Statement
from hallsym.diagnosis.residue import Residue, coordinates_of, residue
from hallsym.diagnosis.smooth import NO_ORDER, Curve, FineMap, Smooth, own_gains
from hallsym.diagnosis.tangent import Base

LEVEL = 0.01
"""Significance that a statement must have, all that was tried counted."""
LIKELY = 0.05
"""Significance that is enough for a coordinate that predicts what certainly differs from run to run."""
CERTAIN = 1e-3
"""Significance of the excess as a whole, below which nothing is said of where it lies."""
LEAST = 0.03
"""Share of the excess that a statement must have."""
SMALL = 0.02
"""Excess over the noise [share of its power] below which nothing is said."""
MOST = 5
NEARLY = 0.92
"""Of coordinates that explain at least this part of what the best one explains the most telling is named."""
RATHER = 0.6
"""A gain of its own in every run is named only where no coordinate explains this part of what it does."""
TOLD = 0.8
HALF = 0.5
"""Shares that coordinates have told of from which on runs, and bands of frequency, add nothing."""
ROUGH = 0.4
"""Part of a fine map's power that is short against the range, from which on it counts as fine structure."""
CLIP = 9.0
"""Whitened square per reading at which a sample stops counting when runs are compared."""
PLACES = (
    "the reading itself", "place in the stroke of x", "place in the stroke of y", "rotation Rz",
    "place in the turn",
)  # fmt: skip
UNITS = {"m": (1e6, "um"), "rad": (1e6, "urad"), "m/s": (1e3, "mm/s")}
"""How places are shown to a person."""


@dataclass(frozen=True, eq=False)
class Located:
    """Statements on where an excess lies, and the curves behind those that are about coordinates."""

    statements: tuple[Statement, ...]
    curves: tuple[Curve, ...]
    fitted: Residue | None


NOTHING = Located((), (), None)


def where(base: Base, runs: Sequence[int], inflation: float = 1.0) -> tuple[Statement, ...]:
    """Return statements on where the excess of `base`'s residual on `runs` above the noise lies.

    Fitted runs are searched; each statement also says its share on those of `runs` that are held out.
    Residuals that are only noise get none. Significance comes from the runs, not from `inflation`.
    """
    return located(base, runs).statements


def located(base: Base, runs: Sequence[int]) -> Located:
    """Return the statements with the curves behind them."""
    fitted = residue(base, [r for r in runs if r not in base.apart])
    if fitted is None or fitted.excess <= SMALL * fitted.residual.size:
        return NOTHING
    statements, curves = _coordinates(fitted)
    held = residue(base, [r for r in runs if r in base.apart])
    if held is not None and held.excess > 0:
        statements = _confirmed(statements, curves, held)
    told = sum(s.share for s in statements)
    marginal = _marginal(fitted, told) if statements or _clear(fitted) else []
    if marginal and "mains" in marginal[0].at and marginal[0].share > told:
        statements, marginal = [marginal[0], *statements], marginal[1:]
    return Located((*statements, *marginal), tuple(curves), fitted)


def _clear(r: Residue) -> bool:
    """Whether the excess is more than chance: block by block, so that memory of the noise does not count."""
    return beyond(_means(r.squares - len(r.residual), r.block)) < CERTAIN


def _means(values: np.ndarray, group: np.ndarray) -> np.ndarray:
    _, index = np.unique(group, return_inverse=True)
    return np.bincount(index, values) / np.bincount(index)


# -- coordinates -------------------------------------------------------------------------------------------


def _coordinates(r: Residue) -> tuple[list[Statement], list[Curve]]:
    """Coordinates one after the other, each with what it explains beyond those before."""
    coordinates = coordinates_of(r)
    tried: list[Smooth | FineMap] = [Smooth(r, c) for c in coordinates]
    tried += [FineMap(r, c) for c in coordinates if c.name in PLACES]
    tried = [t for t in tried if t.values is not None]
    count, excess = len(tried) + 1, r.excess
    statements: list[Statement] = []
    curves: list[Curve] = []
    left = r.residual
    for _ in range(MOST):
        found = [c for t in tried if (c := t.curve(left)) is not None]
        run = _own_gain(r, left, excess, count)
        good = [c for c in found if c.p_value * count < LEVEL and c.explained > LEAST * excess]
        if run:  # a difference from run to run is certain; what predicts most of it on other runs is it
            most = RATHER * run.share * excess
            good += [c for c in found if LEVEL <= c.p_value * count < LIKELY and c.explained > most]
        best = max((c.explained for c in good), default=0.0)
        if run and RATHER * run.share * excess > best:
            statements.append(run)
            break
        if not good:
            break
        first = next(c for c in good if c.explained >= NEARLY * best)
        share = min(first.explained / excess, 1.0 - sum(s.share for s in statements))
        if share < LEAST:
            break
        statements.append(_statement(r, first, share, min(1.0, first.p_value * count), bool(statements)))
        curves.append(first)
        tried = [t for t in tried if t.coordinate.name != first.coordinate.name]
        left = left - first.predicted
    return statements, curves


def _own_gain(r: Residue, left: np.ndarray, excess: float, count: int) -> Statement | None:
    explained, p = own_gains(r, left)
    if p * count >= LEVEL or explained <= LEAST * excess:
        return None
    share = min(explained / excess, 1.0)
    text = (
        f"{_percent(share)} of the excess is a gain that differs from run to run and follows nothing logged"
    )
    return Statement("run", "gain of its own", share, min(1.0, p * count), text)


def _statement(r: Residue, c: Curve, share: float, p: float, further: bool) -> Statement:
    at = "" if c.coordinate.column in NO_ORDER else _most(r, c)
    what = "a further " if further else ""
    form = _form(r, c)
    text = f"{what}{_percent(share)} of the excess goes with {c.coordinate.name}{form}"
    if at:
        text += f", {at}"
    sensor = _mostly(r, c)
    text += f"; seen by {sensor}" if sensor else ""
    return Statement(c.coordinate.name, at, share, p, text)


def _form(r: Residue, c: Curve) -> str:
    """Whether the gain follows the coordinate or the reading as such, or with which period."""
    if c.coordinate.column == "turn_rad":
        return _waves(r, c)
    if c.fine:
        period = _period(c)
        if period:
            return f", in ripples of {_shown(period, c.coordinate.unit)}"
        power = _power(c)
        return ", in fine structure" if power[6:].sum() > ROUGH * power.sum() else ""
    if c.coordinate.column == "vertical":
        offset, gain = (float((c.offset[:, k : k + 3] ** 2).sum()) for k in (0, 3))
        parts = (c.offset**2).sum(axis=0).reshape(2, 3).sum(axis=0)
        each = (f"{a} {_percent(x)}" for a, x in zip(("Z", "Rx", "Ry"), parts / parts.sum(), strict=True))
        what = "the gain: " if gain > 4 * offset else "the offset: " if offset > 4 * gain else ""
        return f" ({what}{', '.join(each)})"
    if c.gain is None:
        return ""
    along = c.gain - c.gain.mean(axis=1, keepdims=True)
    level = c.offset - c.offset.mean(axis=1, keepdims=True)
    gain, offset = float((along**2).mean()), float((level**2).mean())
    return " (the gain)" if gain > 4 * offset else " (the offset)" if offset > 4 * gain else ""


def _waves(r: Residue, c: Curve) -> str:
    """Waves of angle error per turn that hold most of a curve over the turn, the largest first."""
    if len(r.channels) == 2:  # along the turn of the two voltages
        y, x = r.felt - r.felt.mean(axis=1, keepdims=True)
        error = (x * c.predicted[0] - y * c.predicted[1]) / (x**2 + y**2)
    else:
        error = c.predicted[0]
    at, orders = c.values, np.arange(1, 105)
    power = np.array([abs(np.mean((error - error.mean()) * np.exp(-1j * n * at))) for n in orders]) ** 2
    most = orders[np.argsort(-power)[:3]]
    said = [n for n in most if power[n - 1] > 0.1 * power.sum()]
    return f", {' and '.join(map(str, said))} waves per turn" if said else ""


def _period(c: Curve) -> float | None:
    """Period of a fine map, where one line holds most of its power."""
    power = _power(c)
    k = int(np.argmax(power))
    if k < 5 or power[k - 1 : k + 2].sum() < 0.5 * power.sum():
        return None
    near = power[k - 1 : k + 2]
    centre = float(np.arange(k - 1, k - 1 + len(near)) @ near / near.sum())
    return float((c.at[1] - c.at[0]) * len(c.at) / centre)


def _power(c: Curve) -> np.ndarray:
    """Power of a fine map by waves per range."""
    return (np.abs(np.fft.rfft(c.offset - c.offset.mean(axis=1, keepdims=True), axis=1)) ** 2).sum(axis=0)


def _most(r: Residue, c: Curve) -> str:
    """Where along the coordinate the predicted error is largest."""
    x = c.values if c.values.ndim == 2 else np.broadcast_to(c.values, c.predicted.shape)
    low, high = np.quantile(x, [0.005, 0.995])
    place, error = ((x - low) / (high - low)).ravel(), (c.predicted**2).ravel()
    parts = [
        error[mask].mean() if (mask := (place >= a) & (place < b)).any() else 0.0
        for a, b in ((-1, 0.25), (0.25, 0.75), (0.75, 2))
    ]
    unit = c.coordinate.unit
    span = f"({_shown(low, unit, sign=True)} to {_shown(high, unit, sign=True)})"
    if min(parts[0], parts[2]) > 1.5 * parts[1]:
        return f"most at the ends of the range {span}"
    if parts[2] > 2 * max(parts[0], parts[1]):
        return f"most at the upper end, near {_shown(high, unit, sign=True)}"
    if parts[0] > 2 * max(parts[1], parts[2]):
        return f"most at the lower end, near {_shown(low, unit, sign=True)}"
    if parts[1] > 1.5 * max(parts[0], parts[2]):
        return f"most in the middle of the range {span}"
    return f"all over the range {span}"


def _mostly(r: Residue, c: Curve) -> str:
    """The sensor that most of a curve is seen by, if there is one."""
    seen = (c.predicted**2).sum(axis=1) * np.diag(r.precision)
    k = int(np.argmax(seen))
    return f"{_plain(r.channels[k])} above all" if seen[k] > 0.7 * seen.sum() else ""


def _confirmed(statements: list[Statement], curves: list[Curve], held: Residue) -> list[Statement]:
    """Add what each curve, as fitted, explains of the excess on held-out runs."""
    out, left = [], held.residual
    for s, c in zip(statements, curves, strict=False):
        t = Smooth(held, c.coordinate)
        if t.values is None or c.fine or c.coordinate.column in NO_ORDER:
            out.append(s)
            continue
        rest = left - _predicted(c, t.values, held.felt)
        before, after = (float(np.einsum("kn,kl,ln->", x, held.precision, x)) for x in (left, rest))
        out.append(replace(s, held_out=float(np.clip((before - after) / held.excess, -1.0, 1.0))))
        left = rest
    return [*out, *statements[len(out) :]]


def _predicted(c: Curve, x: np.ndarray, felt: np.ndarray) -> np.ndarray:
    """What a curve says of other samples, (K, n)."""
    each = x if x.ndim == 2 else np.broadcast_to(x, felt.shape)
    out = np.array([np.interp(row, c.at, curve) for row, curve in zip(each, c.offset, strict=True)])
    if c.gain is not None:
        gain = np.array([np.interp(row, c.at, curve) for row, curve in zip(each, c.gain, strict=True)])
        out = out + gain * felt / c.scale
    return out


# -- sensors, runs, frequencies ----------------------------------------------------------------------------


def _marginal(r: Residue, told: float) -> list[Statement]:
    return [*_of_frequencies(r, told), *_of_sensors(r), *(_of_runs(r) if told < TOLD else [])]


def _of_sensors(r: Residue) -> list[Statement]:
    """Sensors that see more than their part of the excess."""
    K = len(r.channels)
    parts = r.residual**2 / np.diag(np.linalg.inv(r.precision))[:, None] - 1.0
    shares = parts.sum(axis=1) / max(float(parts.sum()), 1e-300)
    out = []
    for k, name in enumerate(r.channels):
        p = K * beyond(_means(parts[k] - parts.mean(axis=0), r.block))
        if p < LEVEL and shares[k] > 1 / K + 0.1 and parts.sum() > 0:
            share = float(min(shares[k], 1.0))
            text = f"{_percent(share)} of the excess is seen by {_plain(name)}, one of {K} sensors"
            out.append(Statement("sensor", name, share, min(1.0, p), text))
    return sorted(out, key=lambda s: -s.share)[:1]


def _of_runs(r: Residue) -> list[Statement]:
    """A run that has much more than its part of the excess."""
    order, index = np.unique(r.run, return_inverse=True)
    squares = np.minimum(r.squares, CLIP * len(r.residual)) - len(r.residual)
    sums, counts = np.bincount(index, squares), np.bincount(index)
    level = np.log(sums / counts + len(r.residual))
    k, U = int(np.argmax(level)), len(order)
    if U < 6 or sums[k] <= 0:
        return []
    p = U * beyond_one(float(level[k]), np.delete(level, k))
    share = float(np.clip(sums[k] / max(squares.sum(), 1e-300), 0.0, 1.0))
    if p >= CERTAIN or share < max(3 / U, 2 * LEAST):
        return []
    text = f"{_percent(share)} of the excess lies in run {order[k]}, one of {U} fitted runs"
    return [Statement("run", f"run {order[k]}", share, min(1.0, p), text)]


def beyond_one(value: float, others: np.ndarray) -> float:
    """Return the probability that one more of the same kind as `others` exceeds `value` (Student's t)."""
    from scipy.special import stdtr

    n = len(others)
    spread = float(np.std(others, ddof=1)) * np.sqrt(1 + 1 / n)
    return float(stdtr(n - 1, -(value - float(others.mean())) / max(spread, 1e-300)))


def _of_frequencies(r: Residue, told: float) -> list[Statement]:
    """Kinds of frequency that hold more than twice their part of what white noise would have."""
    s = r.spectrum
    runs = sorted({run for kind in s.white.values() for run in kind})
    if len(runs) < 4:
        return []
    white = {k: np.array([v.get(run, 0.0) for run in runs]) for k, v in s.white.items()}
    power = {k: np.array([v.get(run, 0.0) for run in runs]) for k, v in s.power.items()}
    everything = np.sum(list(white.values()), axis=0)
    excess = float(sum(v.sum() for v in power.values()) - everything.sum())
    out = []
    for kind, own in white.items():
        over, part = power[kind] - own, float(own.sum() / everything.sum())
        share = float(over.sum()) / max(excess, 1e-300)
        p = len(white) * beyond(over / everything)
        if excess <= 0 or p >= LEVEL or share < max(2 * part, part + 0.1):
            continue
        if told > HALF and not kind.startswith("the mains"):
            continue
        out.append((share, kind, min(1.0, p)))
    said, rest = [], 1.0
    for share, kind, p in sorted(out, reverse=True)[:2]:
        share = min(share, rest)  # bands below the noise make the others more than the whole
        rest -= share
        if share >= LEAST:
            text = f"{_percent(share)} of the excess lies at {kind}"
            if kind == "the frequencies of the motion" and s.motion_hz:
                text += f" (strongest near {float(np.median(s.motion_hz)):.3g} Hz)"
            said.append(Statement("frequency", kind, share, p, text))
    return said


# -- words -------------------------------------------------------------------------------------------------


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"


def _plain(channel: str) -> str:
    return channel.rpartition("_")[0] or channel


def _shown(value: float, unit: str, *, sign: bool = False) -> str:
    factor, name = UNITS.get(unit, (1.0, unit))
    number = f"{value * factor:+.3g}" if sign and unit not in ("s", "degC") else f"{value * factor:.3g}"
    return f"{number} {name}"
