"""Units, signs and order of columns, in a log and in single runs, by what readings answer to references."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby, permutations, product
from typing import Any

import casadi as ca
import numpy as np
import scipy

from hallsym.errors import InputError
from hallsym.log.quality.findings import Finding, name_of
from hallsym.model import Model
from hallsym.model.arrays import medians_of, on_arrays
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
class Judgement:
    """Findings on units, signs, order and runs, and what explains slopes of the whole log, the best first."""

    findings: tuple[Finding, ...] = ()
    whole: tuple[Explanation, ...] = ()
    spiky: bool = False
    """Whether spikes bend the slopes, so that nothing can be said before they are taken out."""

    def resolved(self, before: Judgement) -> Judgement:
        """Return this judgement of rewired channels with what else would explain those before."""
        others = [e for e in before.whole if not e.only_channels]
        if not others:
            return self
        text = f"Order and signs of channels are resolved; it would do as well that {said(others[0])}."
        return replace(self, findings=(*self.findings, Finding(text[:-1])))

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth a note."""
        return tuple(f.sentence for f in self.findings if not f.refuse)

    def refuse(self) -> None:
        """Raise `InputError` for the first finding that is no matter of opinion."""
        for finding in self.findings:
            if finding.refuse:
                raise InputError(finding.sentence)


def judge_gains(
    log: Any, seen: Responses, holdout: Collection[int] = (), moved_by_state: np.ndarray | float = 0.0
) -> Judgement:
    """Judge what the readings of a log answered to its references; no run in `holdout` is a refusal.

    `moved_by_state`: (runs, n_channels) relative change of gains by the state of each run, as the log has it.
    """
    model = seen.model
    if model.typical or model.computed or not np.all(np.isfinite(model.bounds)):
        return Judgement()
    possible: tuple[np.ndarray, np.ndarray] | None = model.remember("slopes", lambda: _possible(model))
    if possible is None or not seen.moved.any():
        return Judgement()
    if np.median(_worst(seen)) > ALIEN:  # slopes of what the references do not explain mean nothing
        return Judgement()
    usual = _usual(seen, *possible)
    if not usual.possible():
        found = explanations(usual, model.references, model.channels, _units(log, model))
        return Judgement((explained(log, model, found),) if found else (), tuple(found))
    return Judgement(tuple(_by_run(log, seen, usual, holdout, moved_by_state)))


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
    slopes, std = medians_of(seen.slopes, kept), medians_of(seen.std, kept)
    return Slopes(slopes, std, moved, lower, upper)


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
    worst, model, searched = _worst(seen), seen.model, 0
    # a reference that belongs to another run leaves most of a strong reading unexplained
    foreign = (worst > ALIEN) & (np.median(worst) < USUAL)
    strength = seen.signal / np.maximum(seen.signal.max(axis=1, keepdims=True), 1e-300)
    beside = seen.together - usual.found  # what the slopes of the other runs leave, beside the run's own
    left = np.einsum("rjk,rjl,rlk->rk", beside, seen.products, beside) / np.maximum(seen.total, 1e-300)
    off = (left * strength).max(axis=1) > OFF
    varies = np.minimum(VARIES + np.broadcast_to(moved_by_state, seen.signal.shape), MOST)
    for r in np.flatnonzero(foreign | off):
        room = varies[r] * np.abs(usual.found).max(axis=1, keepdims=True)
        near = Slopes(seen.slopes[r], seen.std[r], seen.moved[r], usual.found - room, usual.found + room)
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


BEYOND, WITHIN = 1.5, 1.25
"""Factor beyond what a model allows that is still a plausible scale: a matter for fit and diagnosis. What
explains slopes beyond it has to bring them nearer than that: 57.3 times too large is not nearly 100 times."""
CERTAIN = 6.0
"""Standard deviations that a slope must be outside: of a thousand runs with ten slopes, none is by chance."""
TRIED = 30_000
"""Changes of references that are tried at most; beyond that, none of unit."""
TOGETHER = 256
"""Changes of references that are tried at once."""
MORE = 0.5
"""Cost of what is wrong with a column beside the first, which costs 1: another sign beside another unit, or
values that are too small by a unit, which only a conversion done twice makes."""
AS_GOOD = 2.0
"""Changes more than the fewest that an explanation by other columns may take to be named beside it."""

Units = Mapping[str, Mapping[float, str]]
"""For each column: factor by which its values are too large -> unit it then holds, "" where there is none."""


@dataclass(frozen=True)
class Change:
    """What a column is said to be and what it holds: `source` carries it, inverted if `sign` is -1.

    `factor`: how much too large its values are, `unit` the unit that makes them so ("" where there is none).
    """

    column: str
    source: str
    sign: int = 1
    factor: float = 1.0
    unit: str = ""

    @property
    def cost(self) -> float:
        """How much has to have gone wrong: 1 for a column that is not what it says, more for two ways."""
        ways = (self.source != self.column) + (self.sign < 0) + (self.factor != 1)
        twice = self.factor != 1 and not self.unit
        return 1 + MORE * (ways - 1 + twice) if ways else 0.0

    @property
    def way(self) -> tuple[bool, int, float]:
        """How the column is not what it says."""
        return self.source != self.column, self.sign, self.factor


@dataclass(frozen=True)
class Explanation:
    """Changes that make the slopes possible, and how far the slopes then are from the middle of the range."""

    references: tuple[Change, ...]
    channels: tuple[Change, ...]
    misfit: float

    @property
    def cost(self) -> float:
        """Sum over columns."""
        return sum(c.cost for c in (*self.references, *self.channels))

    @property
    def changes(self) -> tuple[Change, ...]:
        """The columns that are not what they say."""
        return tuple(c for c in (*self.references, *self.channels) if c.cost)

    @property
    def simple(self) -> bool:
        """Whether at most two columns are not what they say, or all of them in one way."""
        return len(self.changes) <= 2 or len({c.way for c in self.changes}) == 1

    @property
    def named(self) -> bool:
        """Whether each factor is that of a unit."""
        return all(c.unit or c.factor == 1 for c in self.changes)

    @property
    def only_channels(self) -> bool:
        """Whether the references are as they say."""
        return not any(c.cost for c in self.references)

    @property
    def only_references(self) -> bool:
        """Whether the channels are as they say."""
        return not any(c.cost for c in self.channels)


@dataclass(frozen=True, eq=False)
class Slopes:
    """Slopes (n_pose, n_channels) that were found, and what they may be.

    `moved`: (n_pose,) references that moved; of the others nothing is known. `std`: standard uncertainties.
    """

    found: np.ndarray
    std: np.ndarray
    moved: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def possible(self) -> bool:
        """Return whether the columns can be what they say."""
        return self._inside(BEYOND)

    def _inside(self, by: float) -> bool:
        low, high = widened(self.lower, self.upper, by)
        room = CERTAIN * self.std
        inside = (self.found >= low - room) & (self.found <= high + room)
        return bool(np.all(inside[self.moved]))

    def explained(self, by: Explanation, references: Sequence[str], channels: Sequence[str]) -> bool:
        """Return whether changes that explain other slopes explain these."""
        rows, columns = ([c.source for c in part] for part in (by.references, by.channels))
        at = np.ix_([references.index(c) for c in rows], [channels.index(c) for c in columns])
        scale = np.array([c.sign * c.factor for c in by.references])[:, None]
        scale = scale * np.array([c.sign / c.factor for c in by.channels])
        moved = self.moved[at[0][:, 0]]
        turned = Slopes(self.found[at] * scale, self.std[at] * abs(scale), moved, self.lower, self.upper)
        return turned._inside(WITHIN)


def widened(lower: np.ndarray, upper: np.ndarray, by: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a range whose ends are moved out by a factor, further from zero or nearer to it."""
    low = np.where(lower > 0, lower / by, lower * by)
    return low, np.where(upper < 0, upper / by, upper * by)


def explanations(
    slopes: Slopes, references: Sequence[str], channels: Sequence[str], units: Units
) -> list[Explanation]:
    """Return what explains slopes best: changes of few columns, and others that do as well, the best first.

    At most one that changes only channels, one that changes only references, and one that changes both; where
    the best takes a conversion done twice, also the best that does not. Empty where nothing explains them.
    """
    best: dict[str, Explanation] = {}
    for found in _tried(slopes, references, channels, units):
        least = min((e.cost for e in best.values() if e.named), default=math.inf)
        if sum(c.cost for c in found.references) > least + AS_GOOD:
            break
        kind = "channels" if found.only_channels else "references" if found.only_references else "both"
        for key in (kind, "named") if found.named else (kind,):
            if key not in best or _order(found) < _order(best[key]):
                best[key] = found
    ranked = sorted(dict.fromkeys(best.values()), key=_order)
    if not ranked:
        return []
    first = ranked[0]
    others = [
        e for e in ranked[1:] if e.cost <= first.cost + AS_GOOD * (e.only_channels or e.only_references)
    ]
    if not first.named and "named" in best:
        others = [best["named"]]
    return [first, *others]


def _order(found: Explanation) -> tuple[float, float]:
    return round(found.cost, 6), found.misfit


def _tried(
    slopes: Slopes, references: Sequence[str], channels: Sequence[str], units: Units
) -> Iterator[Explanation]:
    """Yield what brings all slopes into their range: every change of references with the channels' best.

    Those that change fewer references come first.
    """
    low, high = widened(slopes.lower, slopes.upper, WITHIN)
    size = np.maximum(np.abs(slopes.lower), np.abs(slopes.upper)).max(axis=1)
    size, middle = np.where(size > 0, size, 1.0), 0.5 * (slopes.lower + slopes.upper)
    scales = sorted({1.0, *(f for c in channels for f in units[c])})
    options = [(sign, factor) for sign in (1, -1) for factor in scales]
    price = _costs(options, channels, units)
    values = np.array([sign / factor for sign, factor in options])[:, None, None, None]
    ways = _of_references(references, slopes.moved, units)
    for first in range(0, len(ways[0]), TOGETHER):
        order, sign, factor = (part[first : first + TOGETHER] for part in ways)
        scale = (sign * factor)[:, None, :, None, None]
        # (way, option, pose, carrier, channel)
        turned = values * (scale * slopes.found[order][:, None, :, :, None])
        room = CERTAIN * np.abs(values * (scale * slopes.std[order][:, None, :, :, None]))
        still = ~slopes.moved[order][:, None, :, None, None]
        inside = (turned >= low[:, None] - room) & (turned <= high[:, None] + room)
        possible = np.all(inside | still, axis=2)
        possible &= np.isfinite(price)
        good = possible.any(axis=1).any(axis=1).all(axis=1) & possible.any(axis=1).any(axis=2).all(axis=1)
        for m in np.flatnonzero(good & ~still[:, 0, :, 0, 0].all(axis=1)):
            gap = np.abs(turned[m] - middle[:, None]) / size[:, None, None]
            off = np.where(still[m], 0.0, gap).sum(axis=1)
            assigned = _assigned(np.where(possible[m], off, np.inf) * 1e-6 + price)
            if assigned is None:
                continue
            picked = tuple(change_of(channels[n], channels[c], *options[k], units) for n, c, k in assigned)
            changes = tuple(
                change_of(c, references[order[m, j]], int(sign[m, j]), float(factor[m, j]), units)
                for j, c in enumerate(references)
            )
            yield Explanation(changes, picked, float(sum(off[k, c, n] for n, c, k in assigned)))


def change_of(column: str, source: str, sign: int, factor: float, units: Units) -> Change:
    """Return a change with the unit that its factor means."""
    return Change(column, source, sign, factor, units[source].get(factor, ""))


def _costs(options: Sequence[tuple[int, float]], channels: Sequence[str], units: Units) -> np.ndarray:
    """Cost of each (option, carrier, channel); infinite for a unit that the carrier cannot be in."""
    cost = [
        [
            [
                change_of(n, c, sign, factor, units).cost if factor == 1 or factor in units[c] else np.inf
                for n in channels
            ]
            for c in channels
        ]
        for sign, factor in options
    ]
    return np.array(cost)


def _assigned(cost: np.ndarray) -> list[tuple[int, int, int]] | None:
    """Return (channel, carrier, option) for each channel; None where one cannot be explained."""
    best = cost.min(axis=0)  # (carrier, channel)
    if not (np.isfinite(best).any(axis=0).all() and np.isfinite(best).any(axis=1).all()):
        return None
    carrier, channel = scipy.optimize.linear_sum_assignment(np.where(np.isfinite(best), best, 1e9))
    if not np.isfinite(best[carrier, channel]).all():
        return None
    found = [(int(n), int(c), int(cost[:, c, n].argmin())) for c, n in zip(carrier, channel, strict=True)]
    return sorted(found)


def _of_references(
    references: Sequence[str], moved: np.ndarray, units: Units
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return every change of references, fewest first: carrier, its sign and its factor, (m, n_pose) each.

    A column that did not move is in its unit and has its sign.
    """
    place = {c: k for k, c in enumerate(references)}
    groups = [list(g) for _, g in groupby(sorted(references, key=_unit_of), key=_unit_of)]
    orders = [
        dict(pair for g, o in zip(groups, way, strict=True) for pair in zip(g, o, strict=True))
        for way in product(*(permutations(g) for g in groups))
    ]
    scales = [(1.0, *units[c]) if here else (1.0,) for c, here in zip(references, moved, strict=True)]
    signs = [(1, -1) if here else (1,) for here in moved]
    if len(orders) * math.prod(map(len, scales)) * math.prod(map(len, signs)) > TRIED:
        scales = [(1.0,) for _ in references]
    if len(orders) * math.prod(map(len, signs)) > TRIED:
        orders = [{c: c for c in references}]
    carriers = np.array([[place[order[c]] for c in references] for order in orders])
    sign, factor = np.array(list(product(*signs))), np.array(list(product(*scales)))
    pick = np.indices((len(carriers), len(sign), len(factor))).reshape(3, -1)
    order = carriers[pick[0]]
    # sign and unit belong to the column that carries a coordinate
    sign, factor = (np.take_along_axis(v[k], order, axis=1) for v, k in ((sign, pick[1]), (factor, pick[2])))
    ways = (order != np.arange(len(references))).astype(float) + (sign < 0) + (factor != 1)
    nameless = [[f for f, unit in units[c].items() if not unit] for c in references]
    twice = np.array([np.isin(factor[:, j], nameless[j]) for j in range(len(references))]).T
    cost = np.where(ways > 0, 1 + MORE * (ways - 1 + twice), 0.0).sum(axis=1)
    cheap = np.argsort(cost, kind="stable")
    return order[cheap], sign[cheap], factor[cheap]


def _unit_of(column: str) -> str:
    return column.rpartition("_")[2]
