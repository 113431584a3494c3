"""Where the gap lies: which share of the excess goes with a coordinate, a sensor, a frequency, a run.

Coordinates are taken one after the other, the one that explains most of what is still there first, so that
shares add up to at most the whole and nothing is said twice. Each share is counted on runs that the curve was
not fitted on; each p-value takes runs (or stretches of few runs) as blocks and counts how much was tried.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hallsym.diagnosis.base import Base
from hallsym.diagnosis.chance import beyond
from hallsym.diagnosis.faults import Fault
from hallsym.diagnosis.links import of_links
from hallsym.diagnosis.marginal import (
    CERTAIN,
    LEAST,
    LEVEL,
    means,
    of_frequencies,
    of_powers,
    of_runs,
    outputs,
    sensors,
)
from hallsym.diagnosis.record import Share, Statement
from hallsym.diagnosis.residue import Residue, coordinates, residue
from hallsym.diagnosis.scores import Score
from hallsym.diagnosis.smooth import NO_ORDER, Curve, FineMap, Smooth, own_gains, predicted
from hallsym.diagnosis.words import percent, plain, shown
from hallsym.units import readable

LIKELY = 0.05
"""Significance that is enough for a coordinate that predicts what certainly differs from run to run."""
SMALL = 0.02
"""Excess over the noise [share of its power] below which nothing is said."""
MOST = 5
NEARLY = 0.92
"""Of coordinates that explain at least this part of what the best one explains the most telling is named."""
RATHER = 0.6
"""A gain of its own in every run is named only where no coordinate explains this part of what it does."""
ALIKE = 0.9
"""Part of the largest wave's power from which on a slower one is as likely, see `_orders`."""
ROUGH = 0.4
"""Part of a fine map's power that is short against the range, from which on it counts as fine structure."""


@dataclass(frozen=True, eq=False)
class Located:
    """Statements on where an excess lies, what each place takes by itself, and what both rest on.

    `curves`: behind the statements on coordinates. `fitted`, `held`: the residual on fitted and on held-out
    runs, None where there are no samples.
    """

    statements: tuple[Statement, ...]
    curves: tuple[Curve, ...]
    fitted: Residue | None
    held: Residue | None = None
    shares: tuple[Share, ...] = ()


def where(base: Base, runs: Sequence[int], inflation: float = 1.0) -> tuple[Statement, ...]:
    """Return statements on where the excess of `base`'s residual on `runs` above the noise lies.

    Fitted runs are searched; each statement also says its share on those of `runs` that are held out.
    Residuals that are only noise get none. Significance comes from the runs, not from `inflation`.
    """
    return located(base, runs).statements


def both(base: Base, runs: Sequence[int]) -> tuple[Residue | None, Residue | None]:
    """Return the residual on those of `runs` that are fitted and on those that are held out."""
    apart = (False, True)
    fitted, held = (residue(base, [r for r in runs if (r in base.apart) == held]) for held in apart)
    return fitted, held


def located(
    base: Base,
    runs: Sequence[int],
    scored: Sequence[Score] = (),
    faults: Sequence[Fault] = (),
    variance: float = 1.0,
) -> Located:
    """Return the statements with what they rest on.

    `scored`: the catalogue's effects at `base`, for the links of the chain. `faults`: of samples, their power
    as a part of `variance`, the whitened residual's.
    """
    fitted, held = both(base, runs)
    if fitted is None or fitted.excess <= SMALL * fitted.residual.size:
        return Located((), (), fitted, held)
    statements, curves, alone = _coordinates(fitted)
    if held is not None and held.excess > 0:
        statements = _confirmed(statements, curves, fitted, held)
    if not statements and not _clear(fitted):
        return Located((), tuple(curves), fitted, held)
    told = sum(s.share for s in statements)
    tones, frequencies = of_frequencies(fitted, told)
    if frequencies and "mains" in frequencies[0].at and frequencies[0].share > told:
        statements, frequencies = [frequencies[0], *statements], frequencies[1:]
    size = variance * fitted.residual.size / fitted.excess
    bad = [replace(f, power=f.power * size) for f in faults]
    rest = [of_links(base, scored, fitted, bad)] if scored else []
    rest += [of_powers(p(fitted), fitted.block) for p in (outputs, sensors)]
    rest += [(tones, frequencies), of_runs(fitted, told)]
    said = [s for _, found in rest for s in found]
    shares = [*alone, *(row for rows, _ in rest for row in rows)]
    return Located((*statements, *said), tuple(curves), fitted, held, tuple(shares))


def _clear(r: Residue) -> bool:
    """Whether the excess is more than chance: block by block, so that memory of the noise does not count."""
    return beyond(means(r.squares - len(r.residual), r.block)) < CERTAIN


# -- coordinates -------------------------------------------------------------------------------------------


def _coordinates(r: Residue) -> tuple[list[Statement], list[Curve], list[Share]]:
    """Coordinates one after the other, each with what it explains beyond those before; and each by itself."""
    known = coordinates(r)
    every: list[Smooth | FineMap] = [Smooth(r, c) for c in known]
    every += [FineMap(r, c) for c in known if c.fine]
    tried = [t for t in every if t.values is not None]
    alone: list[Share] = []
    count, excess = len(tried) + 1, r.excess
    statements: list[Statement] = []
    curves: list[Curve] = []
    left = r.residual
    for _ in range(MOST):
        found = [c for t in tried if (c := t.curve(left)) is not None]
        run = _own_gain(r, left, excess, count)
        alone = alone or _alone(r, every, found, run, count)
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
    return statements, curves, alone


def _alone(
    r: Residue,
    every: Sequence[Smooth | FineMap],
    found: Sequence[Curve],
    run: Statement | None,
    count: int,
) -> list[Share]:
    """What each coordinate explains with none before it; of a smooth curve and a fine map the better one."""
    out = []
    for c in dict.fromkeys(t.coordinate for t in every):
        own = [f for f in found if f.coordinate == c]
        if not own:
            logged = c.own or c.column in (*r.columns, *NO_ORDER)
            out.append(
                Share("coordinate", c.name, None, None, "it does not move" if logged else "not logged")
            )
            continue
        share = max(float(np.clip(f.explained / r.excess, 0.0, 1.0)) for f in own)
        out.append(Share("coordinate", c.name, share, min(1.0, count * min(f.p_value for f in own))))
    if run:
        out.append(Share("run", run.at, run.share, run.p_value))
    return out


def _own_gain(r: Residue, left: np.ndarray, excess: float, count: int) -> Statement | None:
    explained, p = own_gains(r, left)
    if p * count >= LEVEL or explained <= LEAST * excess:
        return None
    share = min(explained / excess, 1.0)
    text = f"{percent(share)} of the excess is a gain that differs from run to run and follows nothing logged"
    return Statement("run", "gain of its own", share, min(1.0, p * count), text)


def _statement(r: Residue, c: Curve, share: float, p: float, further: bool) -> Statement:
    at = "" if c.coordinate.column in (*NO_ORDER, "turn_rad") else _most(r, c)  # a turn has no ends
    what = "a further " if further else ""
    form = _form(r, c)
    text = f"{what}{percent(share)} of the excess goes with {c.coordinate.name}{form}"
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
            return f", in ripples of {shown(period, c.coordinate.unit)}"
        power = _power(c)
        return ", in fine structure" if power[6:].sum() > ROUGH * power.sum() else ""
    if c.coordinate.column == "states":
        k = len(r.state)
        offset, gain = (float((c.offset[:, at : at + k] ** 2).sum()) for at in (0, k))
        parts = (c.offset**2).sum(axis=0).reshape(2, k).sum(axis=0)
        names = (readable(n)[2].capitalize() for n in r.state)
        each = (f"{a} {percent(x)}" for a, x in zip(names, parts / parts.sum(), strict=True))
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
    said = _orders(c.values, error)
    return f", {' and '.join(map(str, said))} waves per turn" if said else ""


def _orders(at: np.ndarray, error: np.ndarray) -> list[int]:
    """Waves per turn of up to three sines that hold a tenth of an error's squares each, the largest first.

    One after the other, each fitted beside those before it: where half of a table's knots are held out, a
    wave has images at other orders. Of alike ones the slowest is meant.
    """
    waves = np.exp(-1j * np.outer(np.arange(1, 105), at))
    columns = [np.ones_like(at)]
    said: list[int] = []
    rest = error - error.mean()
    least = 0.1 * float(rest @ rest)
    while len(said) < 3:
        power = 2 * np.abs(waves @ rest) ** 2 / len(at)
        k = int(np.argmax(power >= ALIKE * power.max()))
        if power[k] <= least:
            break
        said.append(k + 1)
        columns += [waves[k].real, waves[k].imag]
        X = np.array(columns).T
        rest = error - X @ np.linalg.lstsq(X, error, rcond=None)[0]
    return said


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
    span = f"({shown(low, unit, sign=True)} to {shown(high, unit, sign=True)})"
    if min(parts[0], parts[2]) > 1.5 * parts[1]:
        return f"most at the ends of the range {span}"
    if parts[2] > 2 * max(parts[0], parts[1]):
        return f"most at the upper end, near {shown(high, unit, sign=True)}"
    if parts[0] > 2 * max(parts[1], parts[2]):
        return f"most at the lower end, near {shown(low, unit, sign=True)}"
    if parts[1] > 1.5 * max(parts[0], parts[2]):
        return f"most in the middle of the range {span}"
    return f"all over the range {span}"


def _mostly(r: Residue, c: Curve) -> str:
    """The sensor that most of a curve is seen by, if there is one."""
    seen = (c.predicted**2).sum(axis=1) * np.diag(r.precision)
    k = int(np.argmax(seen))
    return f"{plain(r.channels[k])} above all" if seen[k] > 0.7 * seen.sum() else ""


def _confirmed(
    statements: list[Statement], curves: list[Curve], fitted: Residue, held: Residue
) -> list[Statement]:
    """Add what each curve, as fitted, explains of the excess on held-out runs."""
    out, left = [], held.residual
    for s, c in zip(statements, curves, strict=False):
        says = predicted(c, fitted, held)
        if says is None:
            out.append(s)
            continue
        rest = left - says
        before, after = (float(np.einsum("kn,kl,ln->", x, held.precision, x)) for x in (left, rest))
        out.append(replace(s, held_out=float(np.clip((before - after) / held.excess, -1.0, 1.0))))
        left = rest
    return [*out, *statements[len(out) :]]
