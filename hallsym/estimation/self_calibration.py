"""Calibration of an encoder without a reference: what the readings tell, and what only the motion tells.

Any periodic change of speed and a change of the table of an encoder look the same in one recording. Notation:
u is the mechanical angle decoded from the readings (electrical phase / P), theta = u + h(u) the true one,
h = Re sum_n h_n exp(i n u) the table, R the turns recorded. Three sources tell h_n:

    readings  (1)  x_c = o_c + (w_c * f)(theta + p_c), one field f under all heads c: no motion is assumed.
                   A change of h by wave n is invisible if n p_c is a multiple of 2 pi for all c (open).
                   w_c(n) = exp(k0 + k1 s + k2 s^2), s = (n - P) / P: the heads' heights over the ring.
    line      (2)  u + h(u) = slow(t): the motion is smooth. A ripple of the motion that is periodic in the
                   turn is added to h in full. E|h_n|^2 / 2 = S(n) / R, S the one-sided density
                   [angle^2 per cycle / turn] of all that is not periodic in the turn.
    speeds    (3)  the angle of a torque ripple falls with the speed squared: h_n + b_n / speed^2. Of two
                   speeds, q = (slow / fast)^2: error sqrt(v_fast + q^2 v_slow) / (1 - q). A kinematic ripple
                   (stepper, gear, coupling) does not fall. Turning back separates neither: both are the same
                   function of the angle in both directions.

Angles are in rad; an electrical angle is P times the mechanical one.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from time import perf_counter
from typing import Any

import numpy as np
import scipy

from hallsym.errors import InputError, counted
from hallsym.estimation.factors import inverse, solve
from hallsym.log.phase import wrapped
from solvers import Problem, newton

TURN = 2 * np.pi
NONE, CONSTANT, COASTING = REFERENCES = ("none", "constant-speed", "coasting")
"""What is known of the motion: nothing; that the drive holds its speed; that nothing drives the rotor."""
SENSOR, MOTION, OPEN = "sensor", "motion", "not separable"
LEAST_TURNS = 1.5
"""Turns of a stretch below which a table over the turn is not to be had."""
STEADY = 0.05
"""Share by which the speed, averaged over a period or `WINDOW` of a turn, may leave its median where it is
constant."""
WINDOW = 0.125
HOLDOUT = 3
"""Turns of a run from which on its last one is the holdout."""
RUNNING = 0.2
"""The same where it may change: a rotor that is slower than this share of its median speed is at its stop."""
PRIOR = np.radians(1.5)
"""Standard deviation [electrical rad] of a wave of the table before the readings are asked: it only holds the
waves that they leave open."""
WEAK = 0.7
"""Standard error of a wave over its prior from which on the readings leave it open: they tell half of it."""
SPEEDS = 1.2
"""Ratio of speeds from which on 1 / speed^2 is separated: the error is 4.3 times that of one speed there."""
CHANCE = 0.05
"""Probability that noise alone shows one of all waves as motion; share of waves outside their intervals."""
HEIGHT = 0.012
"""Standard deviation of k1 and k2 over P: heads whose heights over the ring differ by 1 % of its radius."""
NONLINEAR = 0.002
"""Standard deviation of what a linear Hall bends its reading by, over the amplitude, at each of two to four
waves per period (data sheets state a linearity of .1 to 1.5 %). Heads that bend differently look like a wave
of the table, and nothing shows it: it is counted in the standard errors."""
JOINS = 3.0
"""A head sees the field of the first two if, `TRIAL` steps from their solution, the misfit is at most so many
times theirs; and the ratio to its noise above which a motion shows in the readings."""
TRIAL = 5
"""Newton steps that bring a head that does see it within a few percent of its misfit."""
PERIODS = 8
"""Periods, likeliest first, in which a head is tried; each costs a Newton step."""
DEAD = 0.05
"""Share of the largest amplitude below which a head is dead."""
ROUNDS, SETTLED = 40, 1e-8
"""Newton steps of (1) at most; share of the cost below which what a step promises ends them."""
EVEN = 0.5
"""Share of the mean step of the angle that each step must make: a spline through noisy places swings, so
neighbours are averaged until they do."""
NEIGHBOURS = 2
"""Waves on either side over which the density of what is not periodic is averaged."""


BESIDE = 10
"""Waves of a table beside four per period."""


def waves_of(pairs: int) -> int:
    """Return how many waves a table has: four per period and `BESIDE`."""
    return 4 * pairs + BESIDE


def columns(angle: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Return cosine, then sine columns (samples, 2 waves) of the orders at angles (samples,)."""
    powers = np.empty((len(angle), orders.max(initial=1)), complex)
    powers[:, 0], done = np.exp(1j * angle), 1
    while done < powers.shape[1]:  # exp(i (n + m) u) = exp(i n u) exp(i m u)
        more = powers[:, done : 2 * done]
        np.multiply(powers[:, : more.shape[1]], powers[:, done - 1, None], out=more)
        done *= 2
    waves = powers[:, orders - 1] if len(orders) < powers.shape[1] else powers
    return np.hstack([waves.real, waves.imag])


def phasors(table: np.ndarray) -> np.ndarray:
    """Return c_n of cosine, then sine coefficients (2 waves,): their wave is Re c_n exp(i n u)."""
    half = len(table) // 2
    return np.asarray(table[:half] - 1j * table[half:])


def coefficients(c: np.ndarray) -> np.ndarray:
    """Return cosine, then sine coefficients of phasors: the inverse of `phasors`."""
    return np.concatenate([c.real, -c.imag])


# -- decoding -----------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Plane:
    """x = offset + shape (cos phi, sin phi): offset (heads,), shape (heads, 2), Hall 1 on the cosine axis."""

    offset: np.ndarray
    shape: np.ndarray

    def phase(self, x: np.ndarray) -> np.ndarray:
        """Return the phase (samples,) [rad] of readings (samples, heads), without jumps."""
        c, s = np.linalg.pinv(self.shape) @ (x - self.offset).T
        return np.asarray(np.unwrap(np.arctan2(s, c)))


def plane_of(x: np.ndarray, phases: np.ndarray) -> Plane:
    """Return the ellipse of readings (samples, heads) in closed form; no motion is assumed.

    The plane nearest to the readings, then the algebraic ellipse in it. `phases`: nominal electrical phases
    of the heads, which choose the sense. It is exact for offsets, gains and phases alone; it doubles the
    error of an eccentric magnet, so it is never the result.
    """
    middle = x.mean(axis=0)
    axes = np.linalg.svd(x - middle, full_matrices=False)[2][:2].T
    y = (x - middle) @ axes
    size = np.sqrt((y**2).mean())
    a, b = (y / size).T
    q = np.linalg.lstsq(np.stack([a * a, a * b, b * b, a, b], 1), np.ones(len(a)), rcond=None)[0]
    form = np.array([[q[0], q[1] / 2], [q[1] / 2, q[2]]])
    centre = -np.linalg.solve(2 * form, q[3:])
    values, vectors = np.linalg.eigh(form / (1 + centre @ form @ centre))
    if values[0] <= 0:
        raise InputError("The readings lie on no ellipse: two Halls at least must see the field turn.")
    shape = axes @ (size * vectors @ np.diag(values**-0.5) @ vectors.T)
    away = shape / np.hypot(*shape[0])
    turn = np.array([[away[0, 0], -away[0, 1]], [away[0, 1], away[0, 0]]])  # Hall 1 to the cosine axis
    shape = shape @ turn
    like = sum(shape[k, 1] * -np.sin(phases[k]) * np.hypot(*shape[k]) for k in range(1, len(shape)))
    return Plane(middle + axes @ (size * centre), shape * [1.0, 1.0 if like >= 0 else -1.0])


# -- a stretch of one run, and its turns --------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples of one run while it turns: time (s,), readings (s, heads), decoded mechanical angle u (s,).

    `known`: time of a turn, of the longer stretch that this is a part of.
    """

    run: int
    time: np.ndarray
    readings: np.ndarray
    u: np.ndarray
    known: float | None = None

    @cached_property
    def turns(self) -> float:
        """Turns that it makes."""
        return float(abs(self.u[-1] - self.u[0]) / TURN)

    @cached_property
    def period(self) -> float:
        """Time of a turn: the mean time after which the angle comes round, free of its periodic error."""
        if self.known is not None:
            return self.known
        along = np.abs(self.u - self.u[0])
        later = np.interp(along + TURN, along, self.time)
        inside = along + TURN <= along[-1]
        if not inside.any():
            return float((self.time[-1] - self.time[0]) / self.turns)
        return float((later - self.time)[inside].mean())

    def cut(self, first: float, last: float) -> "Stretch":
        """Return the samples from one number of turns after the beginning to another."""
        along = np.abs(self.u - self.u[0]) / TURN
        take = slice(int(np.searchsorted(along, first)), int(np.searchsorted(along, last)))
        return Stretch(self.run, self.time[take], self.readings[take], self.u[take], self.period)


def stretch_of(
    run: int, time: np.ndarray, x: np.ndarray, pairs: int, plane: Plane, reference: str
) -> Stretch:
    """Return the longest stretch in which a run turns in one direction, at constant speed if that is known.

    Nothing is known with `NONE`: the stretch of constant speed where it is long enough to learn from and to
    judge by, else any. Raises `InputError` for a run that makes too few turns.
    """
    u, whole = plane.phase(x) / pairs, x
    total = abs(u[-1] - u[0])
    window = max(round(len(u) * TURN / max(total, TURN) * max(1 / pairs, WINDOW)), 2)
    if len(u) > 2 * window and total > TURN:
        speed = (u[window:] - u[:-window]) / (time[window:] - time[:-window])
        share = speed / np.median(speed)
        steady, runs = _longest(np.abs(share - 1) < STEADY, window), _longest(share > RUNNING, window)
        enough = np.ptp(u[steady]) >= HOLDOUT * TURN if steady.stop > steady.start else False
        use = steady if reference == CONSTANT or (reference == NONE and enough) else runs
        u, time, x = u[use], time[use], x[use]
    if len(u) < 2 or abs(u[-1] - u[0]) < LEAST_TURNS * TURN:
        made = abs(u[-1] - u[0]) / TURN if len(u) else 0.0
        turns = f"makes {made:.2f} turns without a stop" if _goes_round(whole) else "stands or rocks"
        raise InputError(
            f"Run {run} {turns}; a table over the turn needs {LEAST_TURNS:g} "
            f"at least (two and one more to judge it), of {counted(pairs, 'pole pair')}: let it turn further."
        )
    return Stretch(run, time, x, u)


def _goes_round(x: np.ndarray) -> bool:
    """Whether readings (samples, Halls) vary in two directions by more than `JOINS` times their noise.

    The noise is that between neighbours. Without two directions there is no ellipse, and no phase.
    """
    noise = np.sqrt(0.5 * np.diff(x, axis=0).var(axis=0).mean())
    return bool(np.linalg.svd(x - x.mean(axis=0), compute_uv=False)[1] > JOINS * noise * len(x) ** 0.5)


def _longest(good: np.ndarray, window: int) -> slice:
    """Return the samples of the longest stretch of which no mean over a `window` is bad.

    `good`: of the mean that begins at each sample. A good mean may hold a piece of a ramp: the samples that
    it shares with a bad one are left out.
    """
    edges = np.flatnonzero(np.diff(np.r_[0, good.astype(int), 0]))
    first, last = max(zip(edges[::2], edges[1::2], strict=True), key=lambda e: e[1] - e[0], default=(0, 0))
    ramps = first > 0, last < len(good)
    return slice(first + window * ramps[0], max(last + window * (1 - ramps[1]), first + window * ramps[0]))


OPEN_BELOW = 0.05
"""|2 sin(n p / 2)| of the best pair of heads below which wave n is open: its error is 20 times that of the
difference of the heads, n p is within 3 deg of a multiple of 360."""


def seen(places: Sequence[float] | np.ndarray, count: int) -> np.ndarray:
    """Return (count,) by how much wave n of the table moves the heads against each other, 2 |sin(n p / 2)|.

    `places`: of the heads [rad, mechanical]. Of the best pair; the standard error of a wave is that of the
    difference of two heads over this number.

    >>> np.flatnonzero(seen(np.radians([0, 120, 240]), 9) < OPEN_BELOW) + 1
    array([3, 6, 9])
    """
    n, p = np.arange(1, count + 1), np.asarray(places, dtype=float)
    separation = (p[:, None] - p)[np.triu_indices(len(p), 1)]
    return np.asarray(2 * np.abs(np.sin(np.multiply.outer(n, separation) / 2)).max(axis=1))


# -- the readings alone (1) ---------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Jig:
    """What rings on one jig have in common, of heads and drive.

    `heads`: which heads see one field. `places`: (heads - 1,) p_c [rad]; `heights`: (heads - 1, 3) k.
    `orders`, `ripple`: waves of the drive per turn and their phasors [rad, mechanical] over the angle of the
    drive, from the beginning of the record. `closure_std`: (waves,) error of a wave of the table from the
    readings, over rings, 1 sigma of each of its two parts [rad].
    """

    heads: tuple[int, ...]
    places: np.ndarray
    heights: np.ndarray
    orders: np.ndarray = field(default_factory=lambda: np.zeros(0, int))
    ripple: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    closure_std: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Closure:
    """The table from the readings alone: phasors and standard errors of each part (waves,) [rad].

    `misfit`: rms of what one field leaves, in the unit of the readings; `noise`: the same of turns against
    each other.
    """

    jig: Jig
    table: np.ndarray
    std: np.ndarray
    misfit: float
    noise: float


def on_grid(parts: Sequence[Stretch], size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return angles (size,), readings (size, heads) averaged over whole turns, times (turns, size), noise.

    `noise`: rms of the average's own scatter, from the turns against each other; nan with one turn.
    """
    grid = np.arange(size) * TURN / size
    readings, times = [], []
    for part in parts:
        rows, onward = len(part.u) / part.turns, np.sign(part.u[-1] - part.u[0])
        few, most = (max(int(rows / k), 1) for k in (2 * size, size / 2))
        while few < most and np.diff(onward * _averaged(part.u, few)).min() < EVEN * few * TURN / rows:
            few += 1
        u, t, x = (_averaged(v, few)[:: int(onward)] for v in (part.u, part.time, part.readings))
        keep = np.r_[True, u[1:] > np.maximum.accumulate(u)[:-1]]
        reading, time = (scipy.interpolate.CubicSpline(u[keep], values[keep]) for values in (x, t))
        whole = np.floor((u[-1] - grid) / TURN) - np.ceil((u[0] - grid) / TURN) + 1
        first = grid + TURN * np.ceil((u[0] - grid) / TURN)
        for j in range(int(whole.min())):
            readings.append(reading(first + TURN * j))
            times.append(time(first + TURN * j))
    mean = np.mean(readings, axis=0)
    count = len(readings)
    noise = np.sqrt(np.mean((np.array(readings) - mean) ** 2) / (count - 1)) if count > 1 else np.nan
    return grid, mean, np.array(times), float(noise)


def _averaged(values: np.ndarray, few: int) -> np.ndarray:
    """Return means of `few` neighbours each of values (samples, ...)."""
    count = len(values) // few
    return np.asarray(values[: count * few].reshape(count, few, *values.shape[1:]).mean(axis=1))


def closure_of(
    parts: Sequence[Stretch],
    plane: Plane,
    pairs: int,
    count: int,
    jig: Jig | None = None,
    begin: Closure | None = None,
) -> Closure | None:
    """Return the table from the heads that see one field; None where no two heads do.

    `jig`: places and heights that are known. `begin`: the table of the same readings without it.
    """
    grid, x, times, noise = on_grid(parts, 8 * max(count, 32))
    amplitude = np.hypot(*plane.shape.T)
    if jig is not None:
        return _closed(grid, x, noise, pairs, count, jig, begin, known=True)
    alive = np.flatnonzero(amplitude > DEAD * amplitude.max()).tolist()
    # over time: over the angle decoded from them two Halls are pure cosines, which do not tell the period
    half, ahead = grid[::2], TURN / parts[0].period * times[0]
    even = np.stack([np.interp(grid, ahead, own, period=TURN) for own in x.T], axis=1)
    spectra = np.fft.rfft(even, axis=0)[1 : count + 1].T * (2 / len(even))

    def joined(known: Sequence[Mapping[int, float]], head: int) -> list[Closure]:
        """Return one Newton step with a head beside others at `known` places, in each period, best first.

        A ripple of the motion is the same under all heads over time, in whatever period they stand, so the
        readings decide.
        """
        begins = [
            _begin(spectra, {**places, head: float(p)}, pairs)
            for places in known
            for p in _places(spectra[next(iter(places))], spectra[head], pairs)[0][:PERIODS]
        ]
        trials = (_closed(half, x[::2], noise, pairs, count, b, rounds=1, errors=False) for b in begins)
        return sorted(trials, key=lambda trial: trial.misfit)

    both = list(combinations(alive, 2))
    similarity = [_places(spectra[a], spectra[b], pairs)[1] for a, b in both]
    one, other = both[int(np.argmax(similarity))]
    pair = joined([{one: 0.0}], other)
    found = _closed(grid, x, noise, pairs, count, pair[0].jig, pair[0])
    for head in alive:
        if head not in found.jig.heads:
            # two heads seldom tell their periods: a third is tried beside each that they leave open
            fitting = [t for t in pair if t.misfit < JOINS * np.fmax(pair[0].misfit, noise)]
            beside = fitting if len(found.jig.heads) == 2 else [found]
            known = [dict(zip(t.jig.heads, (0.0, *t.jig.places), strict=True)) for t in beside]
            wider = joined(known, head)[0]
            trial = _closed(half, x[::2], noise, pairs, count, wider.jig, wider, rounds=TRIAL, errors=False)
            if trial.misfit < JOINS * np.fmax(found.misfit, noise):
                found = _closed(grid, x, noise, pairs, count, trial.jig, trial)
    return found if found.misfit < DEAD * amplitude.max() else None


def _places(one: np.ndarray, other: np.ndarray, pairs: int) -> tuple[np.ndarray, float]:
    """Return angles (periods,) from one head to another from their spectra (waves,), and their similarity.

    The fundamental tells the angle modulo a period; the waves beside it order the periods, likeliest first.
    """
    n = np.arange(1, len(one) + 1)
    beside = (n % pairs != 0) if pairs > 1 else n > pairs
    rotation = np.angle(other[pairs - 1] / one[pairs - 1])
    a, b = one[beside], other[beside]
    size = np.linalg.norm(a) * np.linalg.norm(b)
    places = wrapped((rotation + TURN * np.arange(pairs)) / pairs, TURN)
    similarity = np.array([(np.conj(a) * b * np.exp(-1j * n[beside] * p)).sum().real / size for p in places])
    return places[np.argsort(-similarity)], float(similarity.max())


def _begin(spectra: np.ndarray, places: Mapping[int, float], pairs: int) -> Jig:
    """Heads at their `places`, with the gains that their spectra (heads, waves) say."""
    first, *others = sorted(places)
    size = np.abs(spectra[:, pairs - 1])
    heights = np.array([[np.log(size[k] / size[first]), 0.0, 0.0] for k in others])
    return Jig(
        (first, *others), wrapped(np.array([places[k] - places[first] for k in others]), TURN), heights
    )


def _closed(
    grid: np.ndarray,
    x: np.ndarray,
    noise: float,
    pairs: int,
    count: int,
    jig: Jig,
    start: Closure | None = None,
    known: bool = False,
    rounds: int = ROUNDS,
    errors: bool = True,
) -> Closure:
    """Solve (1) from the places of a jig and the table of `start`; of a `known` jig only k0 is free.

    f and the o of each head are linear: they are eliminated, as the offsets of a run are. The others are one
    vector: h (2 waves), then k0, k1, k2, p of each head but the first. The standard errors hold what a bend
    of single heads (`NONLINEAR`) would do to the table, and, where the jig is not known, by how much
    `pairs` + `BESIDE` more waves would change it: a ring has waves beyond its table. Without `errors` they
    are 0.
    """
    m, heads, x = len(grid), len(jig.heads), x[:, list(jig.heads)]
    basis = columns(grid, np.arange(1, count + 1))
    sigma = noise if noise > 0 else 1e-3 * float(x.std())
    own = np.column_stack([jig.heights, jig.places])
    table = np.zeros(2 * count) if start is None else coefficients(start.table)
    begin = np.concatenate([table, own.ravel()])
    given = (
        np.zeros(own.shape) if known else np.tile([0.0, *[(HEIGHT * pairs) ** -2] * 2, 0.0], (heads - 1, 1))
    )
    precision = np.concatenate([np.full(2 * count, (pairs / PRIOR) ** 2), given.ravel()])
    free = np.ones(own.shape, bool) & (not known or np.array([True, False, False, False]))
    free = np.concatenate([np.ones(2 * count, bool), free.ravel()])

    def tangent(
        y: np.ndarray, basis: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Return residual and slopes (heads * samples, unknowns) over the noise, f and o fitted, and what
        gives the products of the slopes, f and o eliminated, with other columns.

        `basis`: (samples, 2 waves) of the table; the field has as many waves."""
        count = basis.shape[1] // 2
        n = np.arange(1, count + 1)
        s = (n - pairs) / pairs
        powers = np.tile(np.array([s**0, s, s**2]), 2)  # of cosine and sine coefficients
        angle, own = grid + basis @ y[: 2 * count], np.vstack([np.zeros(4), y[2 * count :].reshape(-1, 4)])
        fields = [columns(angle + place, n) * np.exp(k @ powers) for *k, place in own]
        linear = np.hstack([np.vstack(fields), np.kron(np.eye(heads), np.ones((m, 1)))])
        normal = linear.T @ linear
        read = x.T.ravel()
        fitted = solve(normal, linear.T @ read[:, None])[:, 0]
        f = fitted[: 2 * count]
        slope = np.concatenate([n * f[count:], -n * f[:count]])  # d f / d angle
        J = np.zeros((heads, m, len(y)))
        for k, (mine, field_) in enumerate(zip(J, fields, strict=True)):
            np.multiply((field_ @ slope)[:, None] / sigma, basis, out=mine[:, : 2 * count])
            if k:
                at = 2 * count + 4 * (k - 1)
                mine[:, at : at + 4] = field_ @ (np.column_stack([*(f * powers), slope]) / sigma)
        rows = J.reshape(heads * m, -1)
        share = solve(normal, linear.T @ rows)
        return (
            (read - linear @ fitted) / sigma,
            rows,
            lambda other: rows.T @ other - share.T @ (linear.T @ other),
        )

    def derivatives(y: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        left, J, product = tangent(y, basis)
        gradient = 2 * (precision * y - J.T @ left)
        return float(left @ left + precision @ y**2), gradient, 2 * (product(J) + np.diag(precision))

    upper = np.where(free, np.inf, begin)
    problem = Problem(lambda points: np.array([derivatives(y)[0] for y in points]),
                      np.where(free, -np.inf, begin), upper, derivatives)  # fmt: skip
    solution = newton(problem, begin, max_iterations=rounds, tolerance=SETTLED)
    y, own = solution.x, solution.x[2 * count :].reshape(-1, 4)
    misfit = sigma * float(np.sqrt((solution.cost - precision @ y**2) / (heads * m)))
    solved = replace(jig, places=own[:, 3], heights=own[:, :3])
    if not errors:
        return Closure(solved, phasors(y[: 2 * count]), np.zeros(count), misfit, noise)
    _, J, product = tangent(y, basis)
    covariance = inverse((product(J) + np.diag(precision))[np.ix_(free, free)])[: 2 * count]
    parts = np.diag(covariance) * max(misfit / sigma, 1.0) ** 2
    bend = np.kron(np.diag(2**0.5 * NONLINEAR * x.std(axis=0)), columns(grid, np.arange(2, 5) * pairs))
    parts += ((covariance @ product(bend)[free] / sigma) ** 2).sum(axis=1)
    if not known:
        more = count + pairs + BESIDE
        at = np.concatenate([np.arange(count), more + np.arange(count), 2 * more + np.arange(own.size)])
        wide, hold = np.zeros(2 * more + own.size), np.full(2 * more + own.size, (pairs / PRIOR) ** 2)
        wide[at], hold[at] = y, precision
        left, J, product = tangent(wide, columns(grid, np.arange(1, more + 1)))
        step = solve(product(J) + np.diag(hold), (J.T @ left - hold * wide)[:, None])[:, 0]
        parts += step[at[: 2 * count]] ** 2
    std = np.sqrt(parts.reshape(2, -1).mean(axis=0))
    return Closure(solved, phasors(y[: 2 * count]), np.minimum(std, PRIOR / pairs), misfit, noise)


# -- the motion (2), (3) ------------------------------------------------------------------------------------

FEW = {1: 1.8, 2: 1.3}
"""Turns -> by how much more than S(n) / R a table is off: slow wander leaks into few turns (simulated)."""
UNBENT = 3
"""Times a ripple of two speeds is solved for, each at an angle freed of it: each leaves n r as much, of n
waves of r rad."""
SMOOTH = 8
"""Degree up to which the slow motion of a coasting rotor is a polynomial of time; one more a turn."""


@dataclass(frozen=True, eq=False)
class Line:
    """The table if the motion is smooth: phasors (waves,) and standard errors of each part [rad].

    `density`: (waves,) S(n), one-sided, of what is not periodic in the turn [rad^2 per cycle / turn]; nan
    where there is one turn. `falling`, `falling_std`: at the highest speed, the part that falls with the
    speed squared, nan without a `ratio` of speeds of `SPEEDS`.
    """

    table: np.ndarray
    std: np.ndarray
    density: np.ndarray
    falling: np.ndarray
    falling_std: np.ndarray
    turns: int
    ratio: float


def slow_of(part: Stretch, time: np.ndarray, reference: str) -> np.ndarray:
    """Return columns (samples, k) of the slow motion of a stretch at some times of it."""
    middle, half = (part.time[0] + part.time[-1]) / 2, (part.time[-1] - part.time[0]) / 2
    degree = 1 if reference != COASTING else int(min(SMOOTH, max(2, part.turns)))
    return np.asarray(np.polynomial.legendre.legvander((time - middle) / half, degree))


def without_slow(part: Stretch, rows: np.ndarray, reference: str) -> np.ndarray:
    """Return what is left of rows (samples, ...) of a stretch once their slow part is eliminated."""
    slow = np.linalg.qr(slow_of(part, part.time, reference))[0]
    return np.asarray(rows - slow @ (slow.T @ rows))


def _speed(part: Stretch, reference: str) -> np.ndarray:
    """Slow speed of the samples [turns per unit of time]."""
    if reference != COASTING:
        return np.full(len(part.time), 1 / part.period)
    slow = slow_of(part, part.time, reference)
    along = slow @ np.linalg.lstsq(slow, np.abs(part.u - part.u[0]) / TURN, rcond=None)[0]
    return np.maximum(np.gradient(along, part.time), 1e-3 / part.period)


def rippled(part: Stretch, jig: Jig | None) -> np.ndarray | float:
    """Return the ripple of the drive that a fleet shows, at the samples [rad]."""
    if jig is None or not len(jig.orders):
        return 0.0
    along = TURN * part.time / part.period
    return np.asarray(columns(along, jig.orders) @ coefficients(jig.ripple))


def line_of(parts: Sequence[Stretch], count: int, reference: str, jig: Jig | None = None) -> Line:
    """Return the table of smooth motion from whole turns, by least squares beside the slow motion."""
    n = np.arange(1, count + 1)
    speeds = [_speed(part, reference) for part in parts]
    fast = max(float(s.max()) for s in speeds)
    ratio = fast / min(float(s.min()) for s in speeds)
    separable = ratio >= SPEEDS
    falls = [(fast / s) ** 2 for s in speeds]
    width = 2 * count * (1 + separable)

    def beside_slow(part: Stretch, share: np.ndarray, found: np.ndarray) -> np.ndarray:
        """Return the columns (samples, width + 1) of table, falling part and what they are to make.

        The falling part is one of the angle without its ripple, which is known from the table `found`.
        """
        table = columns(part.u, n)
        both = [table]
        if separable:
            away = table @ found[: 2 * count] + share * (table @ found[2 * count :])
            both += [columns(part.u + away, n) * share[:, None]]
        return without_slow(part, np.column_stack([*both, rippled(part, jig) - part.u]), reference)

    found = np.zeros(width)
    for _ in range(UNBENT if separable else 1):
        products = np.zeros((width + 1, width + 1))
        for part, share in zip(parts, falls, strict=True):
            rows = beside_slow(part, share, found)
            products += rows.T @ rows
        before, found = found, solve(products[:width, :width], products[:width, width:])[:, 0]
    powers, made = np.zeros((len(parts), count)), []
    for run, (part, share) in enumerate(zip(parts, falls, strict=True)):
        rows = beside_slow(part, share, before)
        table, rest = columns(part.u, n), rows[:, width] - rows[:, :width] @ found
        whole = np.abs(part.u - part.u[0]) / TURN
        for j in range(int(part.turns + 0.02)):
            turn = (whole >= j) & (whole < j + 1)
            half = 2 * np.mean(rest[turn, None] * table[turn], axis=0)
            powers[run] += (half**2).reshape(2, -1).sum(axis=0) / 2
            made.append((run, turn.sum(), 1.0, share[turn].mean()))
    turns, density, variance = len(made), np.full(count, np.nan), np.full((2, count), np.nan)
    run_of, samples, *each = np.array(made).T[: 3 + separable]
    gain = np.linalg.pinv((each * samples) @ np.transpose(each)) @ (each * samples)
    free = np.bincount(run_of.astype(int), 1 - (each * gain).sum(axis=0), len(parts))
    if turns > 1 + separable:
        density = _smooth(powers.sum(axis=0) / free.sum())
        own = free + 1  # each run wanders as it does, and for one turn more as all do
        densities = [(_smooth(p) + density) / f for p, f in zip(powers, own, strict=True)]
        shares = [(gain[:, run_of == run] ** 2).sum(axis=1) for run in range(len(parts))]
        terms = np.array([np.outer(*pair) for pair in zip(shares, densities, strict=True)])
        variance[: 1 + separable] = terms.sum(axis=0)
        known = 2 * (2 * NEIGHBOURS + 1) * np.minimum(own, free.sum())[:, None, None]
        freedom = terms.sum(axis=0) ** 2 / (terms**2 / known).sum(axis=0)
        variance[: 1 + separable] *= few_degrees(freedom)
    std = FEW.get(turns, 1.0) * np.sqrt(variance)
    falling = phasors(found[2 * count : width]) if separable else np.full(count, np.nan, complex)
    if separable:  # a rotor on its own energy adds n r^2 / 8 of 2 n waves that falls with the fourth power
        half = n[: count // 2]
        std[:, 2 * half - 1] = np.hypot(
            std[:, 2 * half - 1], half * np.abs(falling[half - 1]) ** 2 * ratio**2 / (8 * 2**0.5)
        )
    return Line(phasors(found[: 2 * count]), std[0], density, falling, std[1], turns, float(ratio))


def _smooth(density: np.ndarray) -> np.ndarray:
    """Return a density (waves,) averaged over `NEIGHBOURS`."""
    count = len(density)
    return np.array([density[max(k - NEIGHBOURS, 0) : k + NEIGHBOURS + 1].mean() for k in range(count)])


def few_degrees(freedom: np.ndarray) -> np.ndarray:
    """Return the factor of a variance of a phasor that was estimated with so many degrees of freedom.

    With it the circle that holds 95 % of a phasor of known variance holds 95 % of this one: the quantile of
    F(2, freedom) over that of F(2, infinity).
    """
    return np.asarray(freedom / 2 * (CHANCE ** (-2 / freedom) - 1) / -np.log(CHANCE))


def in_step(parts: Sequence[Stretch], pairs: int, reference: str) -> list[Stretch]:
    """Return stretches whose angles count from the same period: readings alone do not tell which it is.

    The one at which the table of a stretch is most like that of the first.
    """
    out, n = [parts[0]], np.arange(1, waves_of(pairs) + 1)
    for part in parts[1:]:
        if pairs > 1:
            one, other = (line_of([p], len(n), reference).table for p in (parts[0], part))
            steps = TURN / pairs * np.arange(pairs)
            similarity = [(np.conj(one) * other * np.exp(1j * n * s)).sum().real for s in steps]
            # the table of the part, read `s` further on, is that of the first
            shift = steps[int(np.argmax(similarity))]
            part = Stretch(part.run, part.time, part.readings, part.u - shift)
        out.append(part)
    return out


# -- what belongs to the sensor, what to the motion ---------------------------------------------------------


@dataclass(frozen=True)
class Wave:
    """One wave of the table, `per_turn` per mechanical turn; phasors and errors in mechanical rad.

    `sensor`: what the table holds. `std`: its standard error per part, None where this recording does not
    separate it from the motion. `motion`: the ripple of the motion that smooth motion would have taken for
    the sensor's, None where nothing tells it; `motion_std`: of each part. `verdict`: `SENSOR` (no ripple of
    the motion shows), `MOTION` (one does, and is separable), `OPEN`.
    """

    per_turn: int
    sensor: complex
    std: float | None
    motion: complex | None
    motion_std: float | None
    verdict: str

    def to_dict(self, pairs: int) -> dict[str, Any]:
        """Return the record of `--json`: amplitudes in rad of mechanical angle."""
        return {
            "per_turn": self.per_turn,
            "per_period": self.per_turn / pairs,
            "sensor_rad": abs(self.sensor),
            "std_rad": self.std,
            "motion_rad": None if self.motion is None else abs(self.motion),
            "motion_std_rad": self.motion_std,
            "verdict": self.verdict,
        }


@dataclass(frozen=True, eq=False)
class SelfCalibration:
    """A calibration without a reference. `kept` is the table, of all `waves`; `left` the holdout errors.

    `left`: name -> rms [electrical rad] about a smooth motion: as it is, and less the ripple of the motion
    that was separable; of the nominal transform, the ellipse and the table. Empty without a turn to spare.
    """

    reference: str
    pairs: int
    plane: Plane
    closure: Closure | None
    line: Line
    waves: tuple[Wave, ...]
    turns: tuple[float, ...]
    left: Mapping[str, tuple[float, float]]
    seconds: float
    ripple: np.ndarray = field(default_factory=lambda: np.zeros(0, complex))
    """(2 waves, ...) phasors of the motion over the angle of the drive, for a fleet."""

    orders: tuple[int, ...] = ()
    """Waves per turn that the table was asked to hold; all where empty."""

    @property
    def kept(self) -> tuple[Wave, ...]:
        """Waves of the table."""
        return tuple(w for w in self.waves if not self.orders or w.per_turn in self.orders)

    @property
    def table(self) -> np.ndarray:
        """Phasors of the table (kept waves,) [rad, mechanical]."""
        return np.array([w.sensor for w in self.kept])

    @property
    def lasting(self) -> np.ndarray:
        """Standard errors of the table (kept waves,) that do not fall with the turns [rad, mechanical].

        What the scatter between turns does not make; 0 of a wave that the recording does not separate.
        """
        own, scatter = np.array([[w.std or 0.0, self.line.std[w.per_turn - 1]] for w in self.kept]).T
        return np.sqrt(np.maximum(own**2 - np.nan_to_num(scatter) ** 2, 0.0))

    def verdicts(self, verdict: str) -> tuple[Wave, ...]:
        """Return the waves of one verdict, largest first: any of the motion, else those of the table."""
        found = [w for w in (self.waves if verdict == MOTION else self.kept) if w.verdict == verdict]
        size = (lambda w: -abs(w.motion or 0)) if verdict == MOTION else (lambda w: -abs(w.sensor))
        return tuple(sorted(found, key=size))


def decided(
    line: Line, unknown: np.ndarray, s_own: np.ndarray, reference: str, so_far: np.ndarray
) -> tuple[Wave, ...]:
    """Return each wave with what it belongs to, and as `Wave.sensor` what it adds to the table `so_far`.

    `line`: the table of smooth motion over the angle that the readings alone give: it would add the sensor's
    error of that angle, less the ripple of the motion. `unknown`, `s_own`: (waves,) what the readings leave
    open, and their standard errors. `so_far`: (waves,).
    """
    count = len(line.table)
    level = -np.log(CHANCE / count)
    variance = s_own**2 + np.nan_to_num(line.std) ** 2
    shows = ~unknown & np.isfinite(line.std) & (np.abs(line.table) ** 2 / (2 * variance) > level)
    bent = np.zeros(count)  # a ripple of n waves in time is n r^2 / 2 of 2 n waves over the angle
    r = np.flatnonzero(shows[: count // 2])
    bent[2 * r + 1] = (r + 1) * np.abs(line.table[r]) ** 2 / 2
    waves = []
    for k in range(count):
        if unknown[k]:
            waves.append(_alone(k, line, reference, level))
            continue
        step, s_line = line.table[k], float(line.std[k])
        if reference == NONE or not np.isfinite(s_line):
            value, std = 0j, float(s_own[k])
        else:
            # a ripple that shows is no error of chance: the line counts by as much less
            doubt = s_line**2 + bent[k] ** 2 + max(0.0, abs(step) ** 2 / 2 - variance[k])
            share = doubt / (doubt + s_own[k] ** 2)
            value, std = (1 - share) * step, float(np.sqrt(share) * s_own[k])
        verdict = MOTION if shows[k] else SENSOR
        waves.append(Wave(k + 1, complex(value), std, complex(-step), float(np.sqrt(variance[k])), verdict))
    if reference == NONE:
        return tuple(waves)
    falls = line.ratio**2 if line.ratio >= SPEEDS else 1.0  # at the lowest speed
    sizes, off = np.zeros(count), s_own.copy()
    for k, (w, c) in enumerate(zip(waves, so_far, strict=True)):
        if w.verdict == OPEN:
            sizes[k] = abs(c)
            off[k] = max(s_own[k], sizes[k])
        else:  # what of the step was not taken for the sensor's
            sizes[k] = falls * abs((w.motion or 0) + w.sensor)
    # a ripple of n waves of size r has a slope n r; an error of m waves of the angle at which it is met turns
    # it into n - m and n + m waves. What is not separable may be a ripple, and an error, as large as it is.
    # So does an error of the waves found here, whose angle is bent by the table so far.
    n = np.arange(1, count + 1)

    def met(waves: np.ndarray, bent_by: np.ndarray) -> np.ndarray:
        """Return the variance (waves,) of waves of the size `waves` over an angle that others bend."""
        beside = np.pad(bent_by**2, (0, count + 1))  # its last is of no wave
        return np.asarray(
            (beside[np.abs(n[:, None] - n) - 1] + beside[n[:, None] + n - 1]) @ (n * waves / 2) ** 2
        )

    errors = np.array([size if w.std is None else w.std for w, size in zip(waves, sizes, strict=True)])
    mixed = met(sizes, off) + met(errors, np.abs(so_far))
    return tuple(
        w if w.std is None else replace(w, std=float(np.sqrt(w.std**2 + more)))
        for w, more in zip(waves, mixed, strict=True)
    )


def _told_by_readings(
    closure: Closure | None, pairs: int, count: int, jig: Jig | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return which waves (count,) the readings leave open, and their standard errors.

    Rings of a fleet tell both by their scatter.
    """
    if closure is None:
        return np.ones(count, bool), np.zeros(count)
    if jig is not None and jig.closure_std is not None:
        std = np.resize(jig.closure_std, count)
        return std * pairs > WEAK * PRIOR, std
    hidden = seen(np.r_[0.0, closure.jig.places], count) < OPEN_BELOW
    return hidden | (closure.std * pairs > WEAK * PRIOR), closure.std


def _alone(k: int, line: Line, reference: str, level: float) -> Wave:
    """A wave that the heads leave open."""
    if reference == NONE:
        return Wave(k + 1, 0j, None, None, None, OPEN)
    value, std = complex(line.table[k]), float(line.std[k])
    if np.isnan(line.falling[k]) or not np.isfinite(std):
        return Wave(k + 1, value, None, None, None, OPEN)
    # (2) learns sensor - ripple: at the highest speed the ripple is that of 1 / speed^2
    motion, error = complex(-line.falling[k]), float(line.falling_std[k])
    shows = abs(motion) ** 2 / (2 * error**2) > level
    if reference == COASTING:
        return Wave(k + 1, value, std, motion, error, MOTION if shows else SENSOR)
    return Wave(k + 1, value, None, motion if shows else None, error if shows else None, OPEN)


def _added(h: np.ndarray, more: np.ndarray) -> np.ndarray:
    """Return the phasors (waves,) of a table `h`, over u, and of one more over theta = u + h(u), over u."""
    n = np.arange(1, len(h) + 1)
    u = np.arange(8 * len(h)) * TURN / (8 * len(h))
    first = columns(u, n) @ coefficients(h)
    both = first + columns(u + first, n) @ coefficients(more)
    return phasors(columns(u, n).T @ both * (2 / len(u)))


def self_calibrate(
    runs: Mapping[int, tuple[np.ndarray, np.ndarray]],
    pairs: int,
    phases: np.ndarray,
    reference: str,
    *,
    orders: Sequence[int] = (),
    jig: Jig | None = None,
    begin: Closure | None = None,
) -> SelfCalibration:
    """Calibrate an encoder without a reference.

    `runs`: run -> times (samples,) and readings (samples, heads). `phases`: nominal electrical phases of the
    heads [rad]. `reference`: one of `REFERENCES`. `orders`: waves per turn of the table, `waves_of(pairs)` by
    default; `jig`: what a fleet knows; `begin`: what the readings say without it. The last whole turn of each
    run is the holdout where it has `HOLDOUT` of them.

    Raises `InputError` for readings that do not turn.
    """
    began = perf_counter()
    for head in range(next(iter(runs.values()))[1].shape[1]):
        size = [float(np.ptp(x[:, head])) for _, x in runs.values()]
        others = max(float(np.ptp(x)) for _, x in runs.values() for x in x.T)
        if max(size) < DEAD * others:
            raise InputError(
                f"Hall {head + 1} is dead: it moves by {max(size):.3g}, the largest by {others:.3g}."
            )
    plane = plane_of(np.concatenate([x for _, x in runs.values()]), phases)
    found = [stretch_of(run, t - t[0], x, pairs, plane, reference) for run, (t, x) in runs.items()]
    # the ends of a record may be ramps: the plane of what turns
    plane = plane_of(np.concatenate([p.readings for p in found]), phases)
    found = [Stretch(p.run, p.time, p.readings, plane.phase(p.readings) / pairs) for p in found]
    sense = np.sign(found[0].u[-1] - found[0].u[0])
    if sense < 0:  # angles count upwards in the first run; the readings alone do not tell the sense
        plane = Plane(plane.offset, plane.shape * [1.0, -1.0])
        found = [Stretch(p.run, p.time, p.readings, -p.u) for p in found]
    found = in_step(found, pairs, reference)
    train = [p.cut(0, np.floor(p.turns) - 1) if p.turns >= HOLDOUT else p for p in found]
    train = [p.cut(0, np.floor(p.turns + 0.02)) if p.turns >= 1 else p for p in train]
    last = max((*orders, waves_of(pairs)))
    most = int(min(len(p.u) / p.turns for p in train) / 4)
    if most < pairs + 1:
        raise InputError(
            f"The log has {4 * most} samples a turn; {counted(pairs, 'pole pair')} need {4 * (pairs + 1)} at "
            "least: sample faster or turn slower."
        )
    count, beyond = (min(k, most) for k in (last, last + pairs + BESIDE))
    # a hundredth of a turn more where it goes on: whole turns from every angle
    ahead = [whole.cut(0, part.turns + 0.01) for part, whole in zip(train, found, strict=True)]
    closure = closure_of(ahead, plane, pairs, count, jig, begin)
    n = np.arange(1, beyond + 1)  # of the line; what a table leaves out mixes into its last waves
    unknown, s_own = _told_by_readings(closure, pairs, count, jig)
    if reference != NONE and jig is None:  # a ripple as large as a usual wave of the table must show
        unknown |= s_own * pairs * np.sqrt(-2 * np.log(CHANCE / count)) > PRIOR
    whole = np.zeros(count, complex) if closure is None else np.where(unknown, 0j, closure.table)
    s_own, whole = (np.pad(v, (0, beyond - count)) for v in (s_own, whole))
    unknown = np.pad(unknown, (0, beyond - count), constant_values=True)
    for turn in range(2):  # a ripple of the motion mixes with what the angle is off by: once more, nearer
        known = [replace(p, u=p.u + columns(p.u, n) @ coefficients(whole)) for p in train]
        line = line_of(known, beyond, reference, jig)
        waves = decided(line, unknown, s_own, reference, whole)
        more = np.array([w.sensor for w in waves])
        whole = _added(whole, more if turn else np.where(unknown, more, 0j))
    waves = tuple(
        replace(w, sensor=0j if w.verdict == OPEN and reference == NONE else complex(c))
        for w, c in zip(waves, whole, strict=True)
    )
    waves, n = waves[:count], n[:count]
    h = coefficients(np.where(np.isin(n, orders or n), [w.sensor for w in waves], 0j))
    drive = coefficients(np.array([w.motion if w.verdict == MOTION and w.motion else 0j for w in waves]))
    left: dict[str, tuple[float, float]] = {}
    judged = [p.cut(np.floor(p.turns) - 1, np.floor(p.turns)) for p in found if p.turns >= HOLDOUT]
    nominal = plane_of_nominal(plane, phases)
    for name, at, table in (("nominal", nominal, None), ("ellipse", plane, None), ("table", plane, h)):
        sums = np.zeros(2)
        for part in judged:
            u = at.phase(part.readings) / pairs
            theta = u if table is None else part.u + columns(part.u, n) @ table
            theta = theta * np.sign((theta[-1] - theta[0]) * (part.u[-1] - part.u[0]))
            own = columns(part.u, n) @ drive if jig is None else rippled(part, jig)
            rest = without_slow(part, np.column_stack([theta, theta - own]), reference)
            sums += pairs**2 * np.mean(rest**2, axis=0) / len(judged)
        if judged:
            left[name] = (float(np.sqrt(sums[0])), float(np.sqrt(sums[1])))
    return SelfCalibration(
        reference, pairs, plane, closure, line, waves, tuple(p.turns for p in found), left,
        perf_counter() - began, _ripple(ahead, closure, pairs, count), tuple(orders),
    )  # fmt: skip


def plane_of_nominal(plane: Plane, phases: np.ndarray) -> Plane:
    """Return the transform that nominal phases and one common gain give, offsets of the ellipse."""
    shape = np.stack([np.cos(phases), -np.sin(phases)], 1)
    return Plane(plane.offset, shape * np.hypot(*plane.shape.T).mean())


def _ripple(parts: Sequence[Stretch], closure: Closure | None, pairs: int, count: int) -> np.ndarray:
    """Phasors of the motion beside the readings alone over the angle of the drive, waves 1 to 2 `count`."""
    if closure is None:
        return np.zeros(0, complex)
    grid, _, times, _ = on_grid(parts[:1], 8 * max(count, 32))
    period = parts[0].period
    ahead = TURN * times.mean(axis=0) / period
    theta = grid + columns(grid, np.arange(1, count + 1)) @ coefficients(closure.table)
    gap = np.unwrap(theta - ahead)
    m = np.arange(1, 2 * count + 1)
    return np.asarray(
        2 * np.mean((gap - gap.mean())[:, None] * np.exp(-1j * np.multiply.outer(ahead, m)), axis=0)
    )
