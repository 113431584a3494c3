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

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter
from typing import Any

import numpy as np
from scipy.interpolate import CubicSpline

from hallsym.errors import InputError, counted
from hallsym.log.phase import wrapped

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
"""Probability that noise alone shows one of all waves as motion."""
HEIGHT = 0.012
"""Standard deviation of k1 and k2 over P: heads whose heights over the ring differ by 1 % of its radius."""
NONLINEAR = 0.002
"""Standard deviation of what a linear Hall bends its reading by, over the amplitude, at each of two to four
waves per period (data sheets state a linearity of .1 to 1.5 %). Heads that bend differently look like a wave
of the table, and nothing shows it: it is counted in the standard errors."""
JOINS = 3.0
"""A head sees the field of the first two if its misfit is at most so many times theirs."""
FAR = 3.0
"""The same beyond `JOINS` where only its place and gain are fitted yet."""
DEAD = 0.05
"""Share of the largest amplitude below which a head is dead."""
ROUNDS, SETTLED = 30, 1e-4
"""Steps of Levenberg and Marquardt at most; share of the cost below which a step ends them."""
TRIAL = 5
"""The same of heads that may see different fields."""
FIRST, LAST = 1e-3, 1e6
"""Their damping, in units of the scaled normal matrix."""
NEIGHBOURS = 2
"""Waves on either side over which the density of what is not periodic is averaged."""


def waves_of(pairs: int) -> int:
    """Return how many waves a table has: four per period and ten beside them."""
    return 4 * pairs + 10


def columns(angle: np.ndarray, orders: np.ndarray) -> np.ndarray:
    """Return cosine, then sine columns (samples, 2 waves) of the orders at angles (samples,)."""
    turned = np.exp(1j * np.multiply.outer(angle, orders))
    return np.hstack([turned.real, turned.imag])


def phasors(table: np.ndarray) -> np.ndarray:
    """Return c_n of cosine, then sine coefficients (2 waves,): their wave is Re c_n exp(i n u)."""
    half = len(table) // 2
    return np.asarray(table[:half] - 1j * table[half:])


def coefficients(c: np.ndarray) -> np.ndarray:
    """Return cosine, then sine coefficients of phasors: the inverse of `phasors`."""
    return np.concatenate([c.real, -c.imag])


def rms(values: np.ndarray) -> float:
    """Return the root mean square about the mean."""
    return float(np.std(values))


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

    Raises `InputError` for a run that makes too few turns.
    """
    u = plane.phase(x) / pairs
    total = abs(u[-1] - u[0])
    window = max(round(len(u) * TURN / max(total, TURN) * max(1 / pairs, WINDOW)), 2)
    if len(u) > 2 * window and total > TURN:
        speed = (u[window:] - u[:-window]) / (time[window:] - time[:-window])
        usual = np.median(speed)
        near = np.abs(speed / usual - 1) < STEADY if reference == CONSTANT else speed / usual > RUNNING
        edges = np.flatnonzero(np.diff(np.r_[0, near.astype(int), 0]))
        first, last = max(
            zip(edges[::2], edges[1::2], strict=True), key=lambda e: e[1] - e[0], default=(0, 0)
        )
        u, time, x = (v[first : last + window] for v in (u, time, x))
    if len(u) < 2 or abs(u[-1] - u[0]) < LEAST_TURNS * TURN:
        made = abs(u[-1] - u[0]) / TURN if len(u) else 0.0
        raise InputError(
            f"Run {run} makes {made:.2f} turns without a stop; a table over the turn needs "
            f"{LEAST_TURNS:g} at "
            "least (two and one more to judge it): let it turn further, or state the pole pairs."
        )
    return Stretch(run, time, x, u)


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
    apart = (p[:, None] - p)[np.triu_indices(len(p), 1)]
    return np.asarray(2 * np.abs(np.sin(np.multiply.outer(n, apart) / 2)).max(axis=1))


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

    def open(self, pairs: int) -> np.ndarray:
        """Return which waves (waves,) the readings leave open: by their errors, or by their places alone."""
        weak = seen(np.r_[0.0, self.jig.places], len(self.std)) < OPEN_BELOW
        return np.asarray(weak | (self.std * pairs > WEAK * PRIOR))


def on_grid(parts: Sequence[Stretch], size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Return angles (size,), readings (size, heads) averaged over whole turns, times (turns, size), noise.

    `noise`: rms of the average's own scatter, from the turns against each other; nan with one turn.
    """
    grid = np.arange(size) * TURN / size
    readings, times = [], []
    for part in parts:
        few = max(int(len(part.u) / part.turns / (2 * size)), 1)  # neighbours that are averaged first
        count = len(part.u) // few
        u, t, x = (
            v[: count * few].reshape(count, few, -1).mean(axis=1) for v in (part.u, part.time, part.readings)
        )
        u, t = u[:, 0], t[:, 0]
        if u[-1] < u[0]:
            u, t, x = u[::-1], t[::-1], x[::-1]
        keep = np.r_[True, u[1:] > np.maximum.accumulate(u)[:-1]]
        reading, time = CubicSpline(u[keep], x[keep]), CubicSpline(u[keep], t[keep])
        whole = np.floor((u[-1] - grid) / TURN) - np.ceil((u[0] - grid) / TURN) + 1
        first = grid + TURN * np.ceil((u[0] - grid) / TURN)
        for j in range(int(whole.min())):
            readings.append(reading(first + TURN * j))
            times.append(time(first + TURN * j))
    mean = np.mean(readings, axis=0)
    count = len(readings)
    noise = np.sqrt(np.mean((np.array(readings) - mean) ** 2) / (count - 1)) if count > 1 else np.nan
    return grid, mean, np.array(times), float(noise)


def closure_of(
    parts: Sequence[Stretch], plane: Plane, pairs: int, count: int, jig: Jig | None = None
) -> Closure | None:
    """Return the table from the heads that see one field; None where no two heads do.

    `jig`: places and heights that are known.
    """
    grid, x, _, noise = on_grid(parts, 8 * max(count, 32))
    amplitude = np.hypot(*plane.shape.T)
    if jig is not None:
        return _closed(grid, x, noise, pairs, count, jig, known=True)
    alive = np.flatnonzero(amplitude > DEAD * amplitude.max())
    every = _begin(x, tuple(alive.tolist()), pairs, count)
    if len(alive) > 2 and noise > 0:  # most machines: all heads see one field
        whole = _closed(grid, x, noise, pairs, count, every, rounds=TRIAL)
        if whole.misfit < FAR * JOINS * noise:
            whole = _closed(grid, x, noise, pairs, count, whole.jig)
        if whole.misfit < JOINS * noise:
            return whole
    begin = _first_pair(x, pairs, count)
    found = _closed(grid, x, noise, pairs, count, begin)
    for head in range(x.shape[1]):
        if head not in found.jig.heads and amplitude[head] > DEAD * amplitude.max():
            more = _joined(grid, x, found, head, pairs, count)
            wider = _closed(grid, x, noise, pairs, count, more) if more else None
            if wider and wider.misfit < JOINS * max(found.misfit, noise if noise > 0 else 0.0):
                found = wider
    return found if found.misfit < DEAD * amplitude.max() else None


def _spectrum(x: np.ndarray, count: int) -> np.ndarray:
    return np.asarray(np.fft.rfft(x, axis=0)[1 : count + 1] * (2 / len(x)))


def _place(one: np.ndarray, other: np.ndarray, pairs: int) -> tuple[float, float]:
    """Return the angle from one head to another from their spectra (waves,), and how alike their fields are.

    The fundamental tells it modulo a period; the waves beside it choose the period.
    """
    n = np.arange(1, len(one) + 1)
    beside = (n % pairs != 0) if pairs > 1 else n > pairs
    turned = np.angle(other[pairs - 1] / one[pairs - 1])
    a, b = one[beside], other[beside]
    size = np.linalg.norm(a) * np.linalg.norm(b)
    places = wrapped((turned + TURN * np.arange(pairs)) / pairs, TURN)
    alike = [(np.conj(a) * b * np.exp(-1j * n[beside] * p)).sum().real / size for p in places]
    best = int(np.argmax(alike))
    return float(places[best]), float(alike[best])


def _first_pair(x: np.ndarray, pairs: int, count: int) -> Jig:
    """The two heads whose fields are most alike."""
    spectra, heads = _spectrum(x, count), range(x.shape[1])
    both = [(a, b) for a in heads for b in heads[a + 1 :]]
    alike = [_place(spectra[:, a], spectra[:, b], pairs)[1] for a, b in both]
    return _begin(x, both[int(np.argmax(alike))], pairs, count)


def _begin(x: np.ndarray, heads: tuple[int, ...], pairs: int, count: int) -> Jig:
    """Places and gains of heads as their spectra over the decoded angle say."""
    spectra = _spectrum(x, count)[:, heads]
    places = [_place(spectra[:, 0], other, pairs)[0] for other in spectra.T[1:]]
    gains = np.log(np.abs(spectra[pairs - 1, 1:] / spectra[pairs - 1, 0]))
    return Jig(heads, np.array(places), np.stack([gains, 0 * gains, 0 * gains], axis=1))


def _joined(grid: np.ndarray, x: np.ndarray, found: Closure, head: int, pairs: int, count: int) -> Jig | None:
    """The jig with one head more; None where the field under it, at angles that are known now, is another."""
    n = np.arange(1, count + 1)
    at = columns(grid + columns(grid, n) @ coefficients(found.table), n)
    both = x[:, [found.jig.heads[0], head]]
    one, other = map(phasors, np.linalg.lstsq(at, both - both.mean(axis=0), rcond=None)[0].T)
    place, _ = _place(one, other, pairs)
    gain = np.log(np.abs(other[pairs - 1] / one[pairs - 1]))
    left = np.linalg.norm(other - one * np.exp(gain + 1j * n * place)) / 2**0.5
    if left > FAR * JOINS * max(found.misfit, found.noise if found.noise > 0 else 0.0):
        return None
    return Jig(
        (*found.jig.heads, head),
        np.r_[found.jig.places, place],
        np.vstack([found.jig.heights, [gain, 0.0, 0.0]]),
    )


def _closed(
    grid: np.ndarray,
    x: np.ndarray,
    noise: float,
    pairs: int,
    count: int,
    jig: Jig,
    known: bool = False,
    rounds: int = 0,
) -> Closure:
    """Solve (1) by Levenberg-Marquardt steps; with a `known` jig only k0 of k and p is free.

    Unknowns in one vector: f and h (2 count each), o (heads), then k0, k1, k2, p of each head but the first.
    The standard errors hold what a bend of single heads (`NONLINEAR`) would do to the table.
    """
    n, m, heads = np.arange(1, count + 1), len(grid), len(jig.heads)
    s = (n - pairs) / pairs
    powers = np.tile(np.array([s**0, s, s**2]), 2)  # of cosine and sine coefficients
    bend, x = columns(grid, n), x[:, list(jig.heads)]
    field_, table = slice(0, 2 * count), slice(2 * count, 4 * count)
    first = 4 * count + heads
    size = first + 4 * (heads - 1)
    own = [slice(first + 4 * k, first + 4 * k + 4) for k in range(heads - 1)]
    free = np.ones(size, bool)
    sigma = noise if noise > 0 else 1e-3 * float(x.std())
    held = np.zeros(size)  # one over the variance of what the readings may leave open
    held[table] = (pairs / PRIOR) ** 2
    y = np.zeros(size)
    y[table.stop : first] = x.mean(axis=0)
    for k, at in enumerate(own):
        y[at] = [*jig.heights[k], jig.places[k]]
        held[at] = [0.0, *[(HEIGHT * pairs) ** -2] * 2, 0.0]
        if known:
            free[at] = [True, False, False, False]
            held[at] = 0.0

    def seen_at(y: np.ndarray) -> list[np.ndarray]:
        v = grid + bend @ y[table]
        other = [columns(v + y[at][3], n) * np.exp(y[at][:3] @ powers) for at in own]
        return [columns(v, n), *other]

    def left_at(y: np.ndarray, seen: list[np.ndarray]) -> np.ndarray:
        return np.asarray(
            (x - y[table.stop : first]).T.ravel() - np.concatenate([w @ y[field_] for w in seen])
        )

    def cost_at(y: np.ndarray, left: np.ndarray) -> float:
        return float(left @ left / sigma**2 + held @ y**2)

    seen = seen_at(y)
    fields = np.vstack(seen)
    y[field_] = np.linalg.solve(fields.T @ fields + 1e-3 * m * np.eye(2 * count), fields.T @ left_at(y, seen))
    left = left_at(y, seen)
    cost, damping = cost_at(y, left), FIRST
    for _ in range(rounds or ROUNDS):
        f = y[field_]
        slope = np.concatenate([n * f[count:], -n * f[:count]])  # d f / d v
        slopes = [w @ slope for w in seen]
        J = np.zeros((heads * m, size))
        for k, (w, d) in enumerate(zip(seen, slopes, strict=True)):
            rows = slice(k * m, (k + 1) * m)
            J[rows, field_], J[rows, table], J[rows, table.stop + k] = w, d[:, None] * bend, 1.0
            if k:
                J[rows, own[k - 1]] = np.column_stack([w @ (f * q) for q in powers] + [d])
        normal = J.T @ J / sigma**2 + np.diag(held)
        right = J.T @ left / sigma**2 - held * y
        scale = np.where(free, np.sqrt(np.diag(normal)) + 1e-300, np.inf)
        normal, right = normal / np.outer(scale, scale), right / scale
        normal[~free, ~free] = 1.0
        while damping < LAST:
            trial = y + np.linalg.solve(normal + damping * np.eye(size), right) / scale
            new_seen = seen_at(trial)
            new_left = left_at(trial, new_seen)
            new_cost = cost_at(trial, new_left)
            if new_cost <= cost:
                break
            damping *= 10
        else:
            break
        gained, cost = cost - new_cost, new_cost
        y, seen, left, damping = trial, new_seen, new_left, damping / 30
        if gained < SETTLED * cost:
            break
    misfit = float(np.sqrt(np.mean(left**2)))
    inverse = np.linalg.inv(normal + FIRST * 1e-6 * np.eye(size))[table]
    parts = np.diag(inverse[:, table]) / scale[table] ** 2 * max(misfit / sigma, 1.0) ** 2
    bend = np.kron(np.diag(2**0.5 * NONLINEAR * x.std(axis=0)), columns(grid, np.arange(2, 5) * pairs))
    parts += ((inverse @ (J.T @ bend / scale[:, None]) / sigma**2 / scale[table, None]) ** 2).sum(axis=1)
    std = np.sqrt(parts.reshape(2, -1).mean(axis=0))
    others = np.array([y[at] for at in own])
    told = Jig(jig.heads, others[:, 3], others[:, :3], jig.orders, jig.ripple, jig.closure_std)
    return Closure(told, phasors(y[table]), np.minimum(std, PRIOR / pairs), misfit, noise)


# -- the motion (2), (3) ------------------------------------------------------------------------------------

CHUNK = 4096
FEW = {1: 1.8, 2: 1.3}
"""Turns -> by how much more than S(n) / R a table is off: slow wander leaks into few turns (simulated)."""
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
    means = (
        [1 / p.period for p in parts]
        if reference != COASTING
        else [s for v in speeds for s in (v.min(), v.max())]
    )
    ratio = max(means) / min(means)
    apart = ratio >= SPEEDS
    q = [(fast / s) ** 2 for s in speeds]
    width = 2 * count * (1 + apart)
    slow = [slow_of(part, part.time, reference) for part in parts]
    total = width + sum(s.shape[1] for s in slow)
    normal, right, at = np.zeros((total, total)), np.zeros(total), width
    aims = [rippled(part, jig) - part.u for part in parts]
    for part, own, share, aim in zip(parts, slow, q, aims, strict=True):
        take = np.r_[np.arange(width), np.arange(at, at + own.shape[1])]
        at += own.shape[1]
        for k in range(0, len(part.u), CHUNK):
            rows = slice(k, k + CHUNK)
            table = columns(part.u[rows], n)
            both = [table, table * share[rows, None]] if apart else [table]
            block = np.hstack([*both, own[rows]])
            normal[np.ix_(take, take)] += block.T @ block
            right[take] += block.T @ aim[rows]
    found = np.linalg.lstsq(normal, right, rcond=1e-14)[0]
    power, turns, design, at = np.zeros(count), 0, [], width
    for part, own, share, aim in zip(parts, slow, q, aims, strict=True):
        table = columns(part.u, n)
        rest = aim - table @ found[: 2 * count] - own @ found[at : at + own.shape[1]]
        if apart:
            rest = rest - (table * share[:, None]) @ found[2 * count : width]
        at += own.shape[1]
        whole = np.abs(part.u - part.u[0]) / TURN
        for j in range(int(part.turns + 0.02)):
            turn = (whole >= j) & (whole < j + 1)
            half = 2 * np.mean(rest[turn, None] * table[turn], axis=0)
            power += (half**2).reshape(2, -1).sum(axis=0) / 2
            design.append([1.0, float(share[turn].mean())])
            turns += 1
    used = 1 + apart
    each = np.array(design)[:, :used]
    spread = np.linalg.pinv(each.T @ each)
    density = power / (turns - used) if turns > used else np.full(count, np.nan)
    density = np.array([density[max(k - NEIGHBOURS, 0) : k + NEIGHBOURS + 1].mean() for k in range(count)])
    worse = FEW.get(turns, 1.0)
    nothing = np.full(count, np.nan)
    return Line(
        phasors(found[: 2 * count]), worse * np.sqrt(density * spread[0, 0]), density,
        phasors(found[2 * count : width]) if apart else nothing.astype(complex),
        worse * np.sqrt(density * spread[1, 1]) if apart else nothing, turns, float(ratio),
    )  # fmt: skip


def in_step(parts: Sequence[Stretch], pairs: int, reference: str) -> list[Stretch]:
    """Return stretches whose angles count from the same period: readings alone do not tell which it is.

    The one at which the table of a stretch is most like that of the first.
    """
    out, n = [parts[0]], np.arange(1, waves_of(pairs) + 1)
    for part in parts[1:]:
        if pairs > 1:
            one, other = (line_of([p], len(n), reference).table for p in (parts[0], part))
            steps = TURN / pairs * np.arange(pairs)
            alike = [(np.conj(one) * other * np.exp(1j * n * s)).sum().real for s in steps]
            # the table of the part, read `s` further on, is that of the first
            shift = steps[int(np.argmax(alike))]
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
    the motion shows), `MOTION` (one does, and is told apart), `OPEN`.
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
    """A calibration without a reference. `kept` is the table, of all `waves`; `left` the errors held out.

    `left`: name -> rms [electrical rad] about a smooth motion: as it is, and less the ripple of the motion
    that was told apart; of the nominal transform, the ellipse and the table. Empty without a turn to spare.
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

    def verdicts(self, verdict: str) -> tuple[Wave, ...]:
        """Return the waves of one verdict, largest first: any of the motion, else those of the table."""
        found = [w for w in (self.waves if verdict == MOTION else self.kept) if w.verdict == verdict]
        size = (lambda w: -abs(w.motion or 0)) if verdict == MOTION else (lambda w: -abs(w.sensor))
        return tuple(sorted(found, key=size))


def decided(
    line: Line,
    closure: Closure | None,
    reference: str,
    pairs: int,
    so_far: np.ndarray,
    jig: Jig | None = None,
) -> tuple[tuple[Wave, ...], np.ndarray]:
    """Return each wave with what it belongs to, and what smooth motion adds to the table (waves,).

    `line`: the table of smooth motion over the angle that the readings alone give: it would add the sensor's
    error of that angle, less the ripple of the motion. `Wave.sensor` is what it adds here to the table
    `so_far` (waves,).
    """
    count = len(line.table)
    level = -np.log(CHANCE / count)
    closed = ~_unknown(closure, pairs, count, jig)
    out = [_alone(k, line, reference, level) if not closed[k] else None for k in range(count)]
    s_own = np.zeros(count) if closure is None else np.array(closure.std)
    if jig is not None and jig.closure_std is not None:
        s_own = np.resize(jig.closure_std, count)
    variance = s_own**2 + np.nan_to_num(line.std) ** 2
    shows = closed & np.isfinite(line.std) & (np.abs(line.table) ** 2 / (2 * variance) > level)
    bent = np.zeros(count)  # a ripple of n waves in time is n r^2 / 2 of 2 n waves over the angle
    for k in np.flatnonzero(shows):
        if 2 * (k + 1) <= count:
            bent[2 * (k + 1) - 1] = (k + 1) * abs(line.table[k]) ** 2 / 2
    for k in np.flatnonzero(closed):
        step, s_line = line.table[k], float(line.std[k])
        if reference == NONE or not np.isfinite(s_line):
            value, std = 0j, float(s_own[k])
        else:
            # a ripple that shows is no error of chance: the line counts by as much less
            doubt = s_line**2 + bent[k] ** 2 + max(0.0, abs(step) ** 2 / 2 - variance[k])
            share = doubt / (doubt + s_own[k] ** 2)
            value, std = (1 - share) * step, float(np.sqrt(doubt * s_own[k] ** 2 / (doubt + s_own[k] ** 2)))
        verdict = MOTION if shows[k] else SENSOR
        out[k] = Wave(int(k) + 1, complex(value), std, complex(-step), float(np.sqrt(variance[k])), verdict)
    waves = [w for w in out if w is not None]
    sizes = [abs(c) if w.verdict == OPEN else abs(w.motion or 0) for w, c in zip(waves, so_far, strict=True)]
    sizes = [z if w.verdict != SENSOR else 0.0 for z, w in zip(sizes, waves, strict=True)]
    off = np.array(
        [max(s, z) if w.verdict == OPEN else s for w, s, z in zip(waves, s_own, sizes, strict=True)]
    )
    if line.ratio >= SPEEDS:  # at the lowest speed
        sizes = [z * line.ratio**2 if w.verdict == MOTION else z for z, w in zip(sizes, waves, strict=True)]
    for i, w in enumerate(waves):
        if w.std is not None and reference != NONE:
            waves[i] = replace(w, std=float(np.hypot(w.std, _mixed(i, sizes, off))))
    return tuple(waves), np.array([w.sensor for w in waves])


def _mixed(k: int, sizes: Sequence[float], off: np.ndarray) -> float:
    """What ripples of the motion and errors of the angle at which they are met make of a wave together.

    A ripple of n waves of size r, of `sizes` (waves,), has a slope n r; an error of m waves of the angle, of
    `off` (waves,), turns it into n - m and n + m waves. What is not separable may be a ripple, and an error,
    as large as it is.
    """
    total = 0.0
    for n, size in enumerate(sizes):
        if size:
            near = [m for m in (abs(k - n) - 1, k + n + 1) if 0 <= m < len(off)]
            total += sum(((n + 1) * size / 2 * off[m]) ** 2 for m in near)
    return float(np.sqrt(total))


def _unknown(closure: Closure | None, pairs: int, count: int, jig: Jig | None) -> np.ndarray:
    """Which waves (count,) the readings leave open; rings of a fleet tell it by their scatter."""
    if closure is None:
        return np.ones(count, bool)
    if jig is not None and jig.closure_std is not None:
        return np.asarray(np.resize(jig.closure_std, count) * pairs > WEAK * PRIOR)
    return closure.open(pairs)


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
) -> SelfCalibration:
    """Calibrate an encoder without a reference.

    `runs`: run -> times (samples,) and readings (samples, heads). `phases`: nominal electrical phases of the
    heads [rad]. `reference`: one of `REFERENCES`. `orders`: waves per turn of the table, `waves_of(pairs)` by
    default; `jig`: what a fleet knows. The last whole turn of each run is held out where it has three.

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
    found = [stretch_of(run, t, x, pairs, plane, reference) for run, (t, x) in runs.items()]
    # the ends of a record may be ramps: the plane of what turns
    plane = plane_of(np.concatenate([p.readings for p in found]), phases)
    found = [Stretch(p.run, p.time, p.readings, plane.phase(p.readings) / pairs) for p in found]
    sense = np.sign(found[0].u[-1] - found[0].u[0])
    if sense < 0:  # angles count upwards in the first run; the readings alone do not tell the sense
        plane = Plane(plane.offset, plane.shape * [1.0, -1.0])
        found = [Stretch(p.run, p.time, p.readings, -p.u) for p in found]
    found = in_step(found, pairs, reference)
    train = [p.cut(0, np.floor(p.turns) - 1) if p.turns >= 3 else p for p in found]
    train = [p.cut(0, np.floor(p.turns + 0.02)) if p.turns >= 1 else p for p in train]
    count = max((*orders, waves_of(pairs)))
    most = int(min(len(p.u) / p.turns for p in train) / 4)
    if most < pairs + 1:
        raise InputError(
            f"The log has {4 * most} samples a turn; {counted(pairs, 'pole pair')} need {4 * (pairs + 1)} at "
            "least: sample faster or turn slower."
        )
    count = min(count, most)
    ahead = [_wider(p, found) for p in train]
    closure = closure_of(ahead, plane, pairs, count, jig)
    n = np.arange(1, count + 1)
    unknown = _unknown(closure, pairs, count, jig)
    whole = np.zeros(count, complex) if closure is None else np.where(unknown, 0j, closure.table)
    for turn in range(2):  # a ripple of the motion mixes with what the angle is off by: once more, nearer
        known = [replace(p, u=p.u + columns(p.u, n) @ coefficients(whole)) for p in train]
        line = line_of(known, count, reference, jig)
        waves, more = decided(line, closure, reference, pairs, whole, jig)
        whole = _added(whole, more if turn else np.where(unknown, more, 0j))
    left_out = [w.verdict == OPEN and reference == NONE for w in waves]
    waves = tuple(
        replace(w, sensor=0j if none else complex(c))
        for w, c, none in zip(waves, whole, left_out, strict=True)
    )
    asked = {*orders} or {*n.tolist()}
    h = coefficients(np.where(np.isin(n, list(asked)), [w.sensor for w in waves], 0j))
    drive = coefficients(np.array([w.motion if w.verdict == MOTION and w.motion else 0j for w in waves]))
    left: dict[str, tuple[float, float]] = {}
    judged = [p.cut(np.floor(p.turns) - 1, np.floor(p.turns)) for p in found if p.turns >= 3]
    nominal = plane_of_nominal(plane, phases)
    for name, at, table in (("nominal", nominal, None), ("ellipse", plane, None), ("table", plane, h)):
        sums = np.zeros(2)
        for part in judged:
            u = at.phase(part.readings) / pairs
            theta = u if table is None else part.u + columns(part.u, n) @ table
            theta = theta * np.sign((theta[-1] - theta[0]) * (part.u[-1] - part.u[0]))
            own = columns(part.u, n) @ drive if jig is None else rippled(part, jig)
            slow = slow_of(part, part.time, reference)
            for k, gap in enumerate((theta, theta - own)):
                rest = gap - slow @ np.linalg.lstsq(slow, gap, rcond=None)[0]
                sums[k] += pairs**2 * float(np.mean(rest**2)) / len(judged)
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


def _wider(part: Stretch, found: Sequence[Stretch]) -> Stretch:
    """The stretch with a hundredth of a turn more where it goes on: whole turns from every angle."""
    (whole,) = (p for p in found if p.run == part.run)
    return whole.cut(0, part.turns + 0.01)


def _ripple(parts: Sequence[Stretch], closure: Closure | None, pairs: int, count: int) -> np.ndarray:
    """Phasors of the motion beside the readings alone over the angle of the drive, waves 1 to 2 `count`."""
    if closure is None:
        return np.zeros(0, complex)
    grid, _, times, _ = on_grid(parts[:1], 8 * max(count, 32))
    period = parts[0].period
    ahead = TURN * times.mean(axis=0) / period
    theta = grid + columns(grid, np.arange(1, count + 1)) @ coefficients(closure.table)
    gap = wrapped(theta - ahead, TURN * 1.0)
    gap = np.unwrap(gap)
    m = np.arange(1, 2 * count + 1)
    return np.asarray(
        2 * np.mean((gap - gap.mean())[:, None] * np.exp(-1j * np.multiply.outer(ahead, m)), axis=0)
    )
