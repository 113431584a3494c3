"""Units, signs and order of columns, in a log and in single runs, by what readings answer to references."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import casadi as ca
import numpy as np

from hallsym.log.quality.explain import BEYOND, Explanation, Slopes, Units, explanations, widened
from hallsym.log.quality.findings import Finding, name_of
from hallsym.model import Model
from hallsym.model.arrays import on_arrays
from hallsym.units import UNITS, split_unit

DEGREE = math.pi / 180
TWICE = (1e3, 1e6, float(f"{1 / DEGREE:.12g}"))
"""Factors of conversions that are done twice by mistake: of mm and um (mrad and urad), and of degrees."""


def scale_of(table: Any, column: str) -> float:
    """Return what the file's numbers of an SI column are multiplied by."""
    bindings = getattr(table, "bindings", {})
    return abs(bindings[column].factor) if column in bindings else 1.0


def other_units(table: Any, column: str) -> dict[float, str]:
    """Return the units that a column may hold instead: how much too large its values then are -> unit.

    Only powers of ten and 180/pi: any other factor is a scale, which a fit and `hallsym diagnose` deal with.
    Values that are too small because they were converted twice are in no unit: "".
    """
    unit = split_unit(column)[1]
    if unit is None:
        return {}
    stated = scale_of(table, column)
    alike = [u for u in UNITS.values() if u.si == unit.si and not u.offset and _plain(u.factor)]
    found = {float(f"{stated / u.factor:.12g}"): u.name for u in alike if not math.isclose(u.factor, stated)}
    twice = [1 / f for f in found if f in TWICE and 1 / f not in found]
    return found | dict.fromkeys(twice, "")


def option(table: Any, column: str, unit: str) -> str:
    """Return the option that states the unit of a column."""
    return f"--column {split_unit(column)[0]}_{unit}={table.source_name(column)}"


def _plain(factor: float) -> bool:
    decades = (math.log10(factor), math.log10(factor / DEGREE))
    return any(abs(d - round(d)) < 1e-9 for d in decades)


@dataclass(frozen=True, eq=False)
class Responses:
    """Slopes d reading / d reference of each run, by linear least squares, and what they leave.

    `slopes`, `std`: (runs, n_pose, n_channels), 0 for a reference that did not move apart from others.
    `moved`: (runs, n_pose). `together`: the slopes with all references, each of which may mean nothing alone.
    `unexplained`: (runs, n_channels) share of a reading's variance that the references leave, 0 where a
    channel hears only noise. `signal`: (runs, n_channels) variance of a reading over that of its noise.
    `products`: (runs, n_pose, n_pose) of the references, `total`: (runs, n_channels) sums of squares of the
    readings, means taken out.
    """

    model: Model
    runs: tuple[int, ...]
    slopes: np.ndarray
    std: np.ndarray
    moved: np.ndarray
    unexplained: np.ndarray
    signal: np.ndarray
    products: np.ndarray
    total: np.ndarray
    together: np.ndarray

    def misfit(self, slopes: np.ndarray) -> np.ndarray:
        """Return what other slopes (n_pose, n_channels) leave of each run's readings, (runs, n_channels).

        As a share of their variance, beside what the run's own slopes leave.
        """
        off = self.together - slopes
        left = np.einsum("rjk,rjl,rlk->rk", off, self.products, off)
        return np.asarray(left / np.maximum(self.total, 1e-300))


VARIES = 0.2
"""Share of the largest slope of a reference by which slopes of one run may differ from those of the others:
temperature and effects move gains that far, beside what the log says of its state columns."""
MOST = 0.9
"""Most of it with the state: a gain that falls further is none, and a unit or a sign is far beyond."""
ALIEN, USUAL = 0.5, 0.1
"""Share of a reading's variance that its reference leaves: in a run to which it does not belong, and in the
others at most for that to say anything."""
WEAK = 0.1
"""Share of the variance of a run's strongest reading below which a channel hears too little to judge."""
OFF = 0.05
"""Share of the variance of a run's strongest reading that slopes of the other runs must leave: an effect
moves slopes of what is hardly heard."""
NAMED, OPTIONS = 3, 2
"""Runs and options that a sentence names."""
LONGEST = 300
"""Characters of a sentence."""
CORNERS = 256
"""Random corners of the bounds at which possible slopes are taken. A slope depends on four or five
parameters, each of whose corners is among them."""
SEARCHED = 6
"""Runs for which everything is tried, at most; further ones are compared with what was found there."""


@dataclass(frozen=True, eq=False)
class Judged:
    """Findings on a log, and the columns that explain slopes of the whole log, the best explanation first."""

    findings: tuple[Finding, ...] = ()
    whole: tuple[Explanation, ...] = ()


def judge_gains(
    log: Any, seen: Responses, holdout: Collection[int] = (), moved_by_state: np.ndarray | float = 0.0
) -> Judged:
    """Judge what the readings of a log answered to its references; no run in `holdout` is a refusal.

    `moved_by_state`: (runs, n_channels) relative change of gains by the state of each run, as the log has it.
    """
    model = seen.model
    if model.typical or model.computed or not np.all(np.isfinite(model.bounds)):
        return Judged()
    possible: tuple[np.ndarray, np.ndarray] | None = model.remember("slopes", lambda: _possible(model))
    if possible is None or not seen.moved.any():
        return Judged()
    if np.median(_worst(seen)) > ALIEN:  # slopes of what the references do not explain mean nothing
        return Judged()
    usual = _usual(seen, *possible)
    if not usual.possible():
        found = explanations(usual, model.references, model.channels, _units(log, model))
        return Judged((explained(log, model, found),) if found else (), tuple(found))
    return Judged(tuple(_by_run(log, seen, usual, holdout, moved_by_state)))


def _units(log: Any, model: Model) -> Units:
    return {c: other_units(log.table, c) for c in (*model.references, *model.channels)}


def _possible(model: Model) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the least and the greatest slopes d reading / d pose, (n_pose, n_channels), within the bounds.

    At the zero pose and state; None where they are not finite there.
    """
    s = model.symbols
    reading = ca.substitute(s.full(s.reading), s.zeros, ca.SX.zeros(s.zeros.numel()))
    at_rest = ca.substitute(
        [ca.densify(ca.jacobian(reading, s.pose))],
        [s.pose, s.state],
        [ca.SX.zeros(s.pose.numel()), ca.SX.zeros(s.state.numel())],
    )
    rng, (lower, upper) = np.random.default_rng(0), model.bounds
    points = np.where(rng.integers(0, 2, (CORNERS, len(lower))) > 0, upper, lower).T
    inside = np.clip(model.nominal, lower, upper)[:, None]
    (values,) = on_arrays(ca.Function("slopes", [s.parameters], at_rest))(np.hstack([points, inside]))
    slopes = np.moveaxis(values.reshape(len(model.pose), len(model.channels), -1), -1, 0)
    return (slopes.min(axis=0), slopes.max(axis=0)) if np.all(np.isfinite(slopes)) else None


def _usual(seen: Responses, lower: np.ndarray, upper: np.ndarray) -> Slopes:
    """Slopes of the whole log: the median over runs, of those that are possible if most are."""
    low, high = widened(lower, upper, BEYOND)
    told = np.broadcast_to(seen.moved[:, :, None], seen.slopes.shape)
    good = told & (seen.slopes >= low) & (seen.slopes <= high)
    kept = np.where(2 * good.sum(axis=0) >= told.sum(axis=0), good, told)
    moved = np.asarray(seen.moved.any(axis=0))
    slopes, std = _medians(seen.slopes, kept), _medians(seen.std, kept)
    return Slopes(slopes, std, moved, lower, upper)


def _medians(values: np.ndarray, kept: np.ndarray) -> np.ndarray:
    """Median over runs of the values that are kept; 0 where none is."""
    ordered, count = np.sort(np.where(kept, values, np.inf), axis=0), kept.sum(axis=0)
    middle = np.maximum(np.array([(count - 1) // 2, count // 2]), 0)
    found = np.take_along_axis(ordered, middle, axis=0).mean(axis=0)
    return np.where(count > 0, found, 0.0)


# -- the whole log ---------------------------------------------------------------------------------------


def explained(log: Any, model: Model, found: Sequence[Explanation]) -> Finding:
    """Return the refusal of a log whose slopes are explained so, in one way or another."""
    text = "; or ".join(said(e) for e in found)
    ways = dict.fromkeys(r for e in found for r in remedies(log, e))
    return sentence(f"In {name_of(log)} {text} against the layout of {model.name}", ways)


def sentence(text: str, ways: Iterable[str]) -> Finding:
    """Return a refusal with as many remedies as one line holds."""
    kept: list[str] = []
    for way in ways:
        if not kept or len(text) + len(", or ".join([*kept, way])) + 3 <= LONGEST:
            kept.append(way)
    return Finding(text, True, remedy=", or ".join(kept))


def said(found: Explanation) -> str:
    """Return what is wrong, in words: order, signs, units."""
    parts: list[str] = []
    for what, changes in (("columns", found.references), ("channels", found.channels)):
        moved = [c.column for c in changes if c.source != c.column]
        if moved:
            parts.append(f"{what} {listed(moved)} look swapped")
    flipped = [c.source for c in found.changes if c.sign < 0]
    if flipped:
        parts.append(f"the sign of {listed(flipped)} looks inverted")
    for factor in dict.fromkeys(c.factor for c in found.changes if c.factor != 1):
        columns = [c for c in found.changes if c.factor == factor]
        for unit in dict.fromkeys(c.unit for c in columns):
            names = [c.source for c in columns if c.unit == unit]
            many = "s" if len(names) == 1 else ""
            parts.append(
                f"{listed(names)} look{many} like {unit}"
                if unit
                else f"{listed(names)} look{many} {1 / factor:.4g} times too small (converted twice?)"
            )
    return " and ".join(parts)


def remedies(log: Any, found: Explanation) -> Iterator[str]:
    """Yield what to do about an explanation."""
    units = [option(log.table, c.source, c.unit) for c in found.changes if c.unit]
    if units:
        yield f"say {' '.join(units[:OPTIONS])}{' and so on' * (len(units) > OPTIONS)}"
    if any(c.sign < 0 or c.source != c.column for c in found.references):
        yield "state sign and order of columns in a column file"
    if any(c.sign < 0 or c.source != c.column for c in found.channels):
        yield "check the wiring, give the machine's probes in meta.json"
        if found.only_channels and not units:
            yield "resolve it with --resolve-wiring"


# -- single runs -----------------------------------------------------------------------------------------


def _by_run(
    log: Any, seen: Responses, usual: Slopes, holdout: Collection[int], moved_by_state: np.ndarray | float
) -> Iterator[Finding]:
    """Runs whose slopes are not those of the others, each way of being wrong in one sentence."""
    if len(seen.runs) < 2:
        return
    groups: dict[str, list[int]] = {}
    known: list[tuple[Explanation, str]] = []
    foreign, model, searched = _foreign(seen), seen.model, 0
    strength = seen.signal / np.maximum(seen.signal.max(axis=1, keepdims=True), 1e-300)
    off = (seen.misfit(usual.found) * strength).max(axis=1) > OFF
    varies = np.minimum(VARIES + np.broadcast_to(moved_by_state, seen.signal.shape), MOST)
    for r in np.flatnonzero(foreign | off):
        near = _near(seen, usual, int(r), varies[r])
        if not foreign[r] and near.possible():
            continue
        text = ""
        if not near.possible():
            text = next((t for e, t in known if near.explained(e, model.references, model.channels)), "")
        if not text and searched < SEARCHED and not near.possible():
            searched += 1
            found = explanations(near, model.references, model.channels, _units(log, model))
            if found and found[0].simple:
                text = "; or ".join(said(e) for e in found if e.simple)
                known.append((found[0], text))
        if not text:
            text = "the references explain less than half of the readings: one of them is another run's"
            text = text if foreign[r] else _odd(near, model)
        groups.setdefault(text, []).append(seen.runs[r])
    for text, runs in groups.items():
        yield _run_finding(log, runs, text, holdout)


def _run_finding(log: Any, runs: Sequence[int], text: str, holdout: Collection[int]) -> Finding:
    """Return what is wrong with runs: a refusal unless all of them are held out."""
    them, used = "it" if len(runs) == 1 else "them", [run for run in runs if run not in holdout]
    leave = f"leave {them} out with --holdout {','.join(map(str, used[:NAMED]))}"
    remedy = f"correct {them}, or {leave}" if used else f"correct {them} before judging a fit by {them}"
    whole, short = (f"In {few(runs)}{of} {text}, beside the other runs" for of in (f" of {name_of(log)}", ""))
    fits = len(whole) + len(remedy) + len(": .") <= LONGEST
    return Finding(whole if fits else short, bool(used), remedy=remedy)


def _near(seen: Responses, usual: Slopes, r: int, varies: np.ndarray) -> Slopes:
    """Slopes of run r beside those of the others, which may differ by the share `varies` (n_channels,)."""
    room = varies * np.abs(usual.found).max(axis=1, keepdims=True)
    return Slopes(seen.slopes[r], seen.std[r], seen.moved[r], usual.found - room, usual.found + room)


def _odd(near: Slopes, model: Model) -> str:
    """Return how slopes of a run are unlike those of the others."""
    low, high = near.lower, near.upper
    size = np.maximum(high - low, 1e-300)
    off = np.where(near.moved[:, None], np.maximum(low - near.found, near.found - high) / size, -1.0)
    j, k = np.unravel_index(int(off.argmax()), off.shape)
    middle = 0.5 * (low + high)[j, k]
    return (
        f"{model.channels[k]} changes by {near.found[j, k]:.3g} per {model.references[j]} where {middle:.3g} "
        "is usual: references, readings or machine of another run"
    )


def _foreign(seen: Responses) -> np.ndarray:
    """Return which runs (runs,) have a reference that leaves most of a strong reading unexplained."""
    worst = _worst(seen)
    return np.asarray((worst > ALIEN) & (np.median(worst) < USUAL))


def _worst(seen: Responses) -> np.ndarray:
    """Return the largest share of a strong reading that is left unexplained, (runs,)."""
    strong = (seen.signal > WEAK * seen.signal.max(axis=1, keepdims=True)) & (seen.signal > 1 / WEAK)
    return np.asarray(np.where(strong, seen.unexplained, 0.0).max(axis=1))


def few(runs: Sequence[int]) -> str:
    """Return runs by number, the first of many.

    >>> few([5]), few([3, 4]), few([1, 2, 3, 4, 5])
    ('run 5', 'runs 3 and 4', 'runs 1, 2, 3 and 2 more')
    """
    if len(runs) == 1:
        return f"run {runs[0]}"
    if len(runs) <= NAMED:
        return f"runs {listed(list(map(str, runs)))}"
    return f"runs {', '.join(map(str, runs[:NAMED]))} and {len(runs) - NAMED} more"


def listed(names: Sequence[str]) -> str:
    """Return names with commas and an and."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
