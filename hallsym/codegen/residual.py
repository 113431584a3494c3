"""Readings that contradict one another: when that is a fault, of which of them, and what a fault can do.

A decoder with more readings than unknowns knows what each of them should be. The sum of squares of what is
left is compared with the least that noise and approximations explain (the global test of Baarda, A Testing
Procedure for Use in Geodetic Networks, Delft 1968); where it is more, the largest normalised residual names
the suspect, and the pose is decoded again by the reading at which nothing of that residual is left. All that
is said of it comes from the generated arithmetic itself, at poses of the box: how each reading moves the
pose, and what is left of the others (internal and external reliability).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from math import ceil, log
from typing import Any

import casadi as ca
import numpy as np
from scipy.stats import chi2, norm

from hallsym.codegen.decoupler import (
    AGREEMENT,
    FAULT,
    OF_ROOT,
    ROOT,
    Array,
    Box,
    Collected,
    Decoupler,
    Flag,
    Redundancy,
    Watched,
    flag_bit,
    steps_on_arrays,
    unit,
)
from hallsym.errors import counted
from hallsym.model import Model
from hallsym.records import named

FALSE_ALARMS = 1e-6
"""Largest share of the samples of a sound machine in which the flag of a fault may be set."""
LEAST = f"least_{AGREEMENT}"
"""Entry that the flag looks at."""
SUM = "contradiction"
"""Step of the sum of squares, whose parts have names that begin with it."""
POSES = 200
"""Poses of the box over which readings are judged."""
OWN_POSES = 5000
"""Poses over which it is met what approximations leave of readings without noise."""
SAFE = 1.5
"""Times what these poses show of the decoder's own approximations, and of a pose without its suspect."""
NUDGE = 1.0
"""Standard deviations by which a reading is moved either way to see what follows it: far above the steps
of polynomials."""
FORMS = 40
"""Poses of these at which degrees of freedom are counted."""
MASKED = 1e-3
"""Share of the square of a fault below which the sum does not see it."""
ISOLABLE = 0.1
"""Least share of the square of a fault that is left once another reading is taken for the suspect: with
less, the two are confusable."""
BENDS = 0.02
"""Share of a reading's range from which on a fault is followed on the arithmetic itself."""
GROWN = 50
"""Sizes of a fault that grows from one standard deviation to the range."""
STUCK = 5000
"""Poses at which a reading sticks."""
SURE = 0.999
"""Share of dead readings that raise a bit within as many samples as are stated."""
NUDGED = 1 << 24
"""First step of integers, whose residuals have exponents of their own."""
SECANTS = 4
"""Times a pose is decoded without its suspect: its reading at the middle of its range, what is left taken off
it, and steps along the line through the last two."""
MEANING = "readings contradict one another by more than noise explains: nothing is claimed of the pose"


def flag() -> Flag:
    """Return the flag of readings that contradict one another."""
    return Flag(FAULT, AGREEMENT, LEAST, MEANING)


def summed(made: Collected, watched: Sequence[Watched]) -> Redundancy:
    """Add the sum of squares of what is left of readings, and the entry that it is compared with.

    Where one thing is left, its size does as well, and integers keep its digits.
    """
    about = "less the largest contradiction that noise and approximations explain"
    made.entry(LEAST, 0.0, "1", about, "sign")
    if len(watched) == 1:
        made.step(AGREEMENT, -ca.fabs(made.symbols[watched[0].left]), "less what the readings contradict")
        return Redundancy(tuple(watched))
    terms = [made.symbols[w.left] * made.symbols[w.error or w.left] for w in watched]
    made.step(AGREEMENT, -made.total(SUM, terms, "squares of what is left of the readings"))
    return Redundancy(tuple(watched))


def left_names(rows: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return the names of what is left of readings: of all where there is one row, else of each."""
    return ["left_of_all"] if len(rows) == 1 else [f"left_{n}" for n in names[: len(rows)]]


def left_over(
    made: Collected, rows: np.ndarray, readings: Mapping[str, ca.SX], remark: str
) -> Redundancy | None:
    """Add rows (1 or n, n) of readings by name, which are 0 where these agree; None without rows."""
    watched, every = [], tuple(range(len(readings)))
    for k, (name, row) in enumerate(zip(left_names(rows, list(readings)), rows, strict=True)):
        terms = [
            made.entry(f"{name}_{own}", share, "1", f"share of {own} in what is left") * value
            for (own, value), share in zip(readings.items(), row, strict=True)
        ]
        made.total(name, terms, remark)
        watched.append(Watched(name, every if len(rows) == 1 else (k,)))
    return summed(made, watched) if watched else None


def drawn_of(model: Model, p: np.ndarray, box: Box) -> Callable[[np.random.Generator, int], np.ndarray]:
    """Return random inputs (n_inputs, s) of poses and states within a box."""
    columns = (*model.pose, *model.state)

    def drawn(rng: np.random.Generator, count: int) -> np.ndarray:
        low, high = np.array([box.ends[c] for c in columns]).T
        share = rng.random((len(columns), count))
        share[:, : count // 20] = np.round(share[:, : count // 20])
        pose, state = np.split(low[:, None] + (high - low)[:, None] * share, [len(model.pose)])
        return np.vstack([model.readings(p, pose, state), state])

    return drawn


def judged(d: Decoupler, sigma: np.ndarray) -> Decoupler:
    """Return the decoupler with the limit of its contradictions, and what is said of its readings.

    `sigma` (n_channels,): standard deviation of each reading, by noise and what the model leaves of it.
    """
    if d.redundancy is None:
        return replace(d, of_faults=(_nothing_left_over(d),))
    if not d.redundancy.watched:
        return d
    found = _Judgement(d, sigma)
    limit = found.limit if d.suspects else np.sqrt(found.limit)
    table = tuple(replace(e, value=-float(limit)) if e.name == LEAST else e for e in d.table)
    root = Array(ROOT, tuple(found.root.tolist()), "1", OF_ROOT)
    redundancy = found.redundancy
    arrays = (*d.arrays, root) if d.suspects else d.arrays
    return replace(
        d, table=table, arrays=arrays, redundancy=redundancy, of_faults=found.said,
        evident=d.evident and not redundancy.mended,  # an analysis does not see where a secant ends
    )  # fmt: skip


def _nothing_left_over(d: Decoupler) -> str:
    n, unknowns = len(d.model.channels), counted(len(d.pose), "unknown")
    return (
        f"{counted(n, 'reading')}, {unknowns}: nothing is left over to check a reading by. One that is dead, "
        f"stuck or drifts gives a wrong {d.quantity} with status 0 as long as it stays within its range."
    )


class _Judgement:
    """What the arithmetic of a decoupler makes of its readings, at poses of the box."""

    def __init__(self, d: Decoupler, sigma: np.ndarray) -> None:
        self.d, self.sigma, self.n = d, np.asarray(sigma, dtype=float), len(d.model.channels)
        watched, flags = d.watched, [f for f in d.flags if f.name != FAULT]
        assert d.drawn is not None  # of every decoder whose readings are watched
        self.drawn = d.drawn
        self.inputs = d.drawn(np.random.default_rng(11), POSES)
        wide = tuple(w.error for w in watched if w.error)
        self.run = steps_on_arrays(replace(d, flags=(*flags, *(Flag(e, e, LEAST, "") for e in wide))))
        self.at = self._seen(self.inputs)

    def _seen(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Pose, what is left of the readings, and what each is multiplied with in the sum."""
        d, watched = self.d, self.d.watched
        pose, *others = self.run(inputs, d.constants)
        left = others[-1]
        errors = others[0][len(others[0]) - len(watched) :] if watched[0].error else left
        return pose, left, errors

    def _once(self, inputs: np.ndarray, samples: Any) -> "Ran":
        pose, left, _ = self._seen(inputs)
        none = np.zeros(inputs.shape[1], np.uint32)
        return Ran(pose, none, left, none)

    @cached_property
    def slopes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """By a reading, per standard deviation: pose (n, pose, s), what is left and its factor (n, m, s)."""
        found = []
        for k, size in enumerate(NUDGE * self.sigma):
            move = size * np.eye(len(self.inputs))[:, [k]]
            up, down = self._seen(self.inputs + move), self._seen(self.inputs - move)
            found.append((self.d.difference(up[0], down[0]), up[1] - down[1], up[2] - down[2]))
        by_pose, left, factor = (np.array(rows) / (2 * NUDGE) for rows in zip(*found, strict=True))
        return by_pose, left, factor

    @cached_property
    def seen(self) -> np.ndarray:
        """Part (n, s) of the sum of squares that one standard deviation of each reading makes [V2]."""
        _, left, errors = self.slopes
        return np.asarray((left * errors).sum(axis=1))

    @cached_property
    def _sizes(self) -> np.ndarray:
        """Eigenvalues (FORMS, n) of the sum as a quadratic form of the readings at some poses."""
        _, left, errors = (v[..., :FORMS].transpose(2, 0, 1) for v in self.slopes)
        return np.asarray(np.linalg.eigvals(left @ errors.transpose(0, 2, 1)).real)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the sum: the most over the poses."""
        return int((self._sizes > MASKED * self._sizes.max(axis=1, keepdims=True)).sum(axis=1).max())

    @property
    def unit(self) -> float:
        """Value [V2] of the sum of squares of one standard deviation that the decode leaves alone."""
        return float(self._sizes.max())

    @cached_property
    def noise(self) -> float:
        """Root of the sum that noise exceeds in `FALSE_ALARMS` of the samples, over its unit."""
        return float(np.sqrt(chi2.isf(FALSE_ALARMS, self.freedom)))

    @cached_property
    def limit(self) -> float:
        """Most of the sum [V2]: noise, and what approximations leave of readings without noise."""
        _, left, errors = self._seen(self.drawn(np.random.default_rng(13), OWN_POSES))
        own = np.sqrt(np.maximum((left * errors).sum(axis=0), 0.0).max())
        return float((self.noise * np.sqrt(self.unit) + SAFE * own) ** 2)

    @cached_property
    def span(self) -> np.ndarray:
        """Standard deviations (n,) that a reading can be off by within its range."""
        return np.array([np.ptp(self.d.ends(c)) for c in self.d.model.channels]) / self.sigma

    @cached_property
    def most(self) -> float:
        """Root of the sum that a fault must add to be flagged whatever the noise does."""
        return float(np.sqrt(self.limit) + self.noise * np.sqrt(self.unit))

    def _unflagged(self, seen: np.ndarray) -> np.ndarray:
        """Largest fault (..., s) [standard deviations] that may raise no bit, of what one makes of the
        sum."""
        with np.errstate(divide="ignore"):
            fault = self.most / np.sqrt(np.maximum(seen, 0.0))
        return np.minimum(fault, self.span[:, None])

    @cached_property
    def faults(self) -> tuple[np.ndarray, np.ndarray]:
        """Largest fault (n, s) [standard deviations] that may raise no bit, and what it moves (n, pose, s).

        Where a straight line says that it may be as large as the range, it grows on the arithmetic itself.
        """
        size = self._unflagged(self.seen)
        moved = np.abs(self.slopes[0]) * size[:, None]
        for k in np.flatnonzero((size >= BENDS * self.span[:, None]).any(axis=1)):
            size[k], moved[k] = self._grown(int(k))
        return size, moved

    def _grown(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """Largest fault (s,) and what it moves (pose, s) as far as no bit is raised, and one size further."""
        size, moved = np.zeros(POSES), np.zeros((len(self.d.pose), POSES))
        grown = np.geomspace(1.0, self.span[k], GROWN)
        right = np.tile(self.at[0], GROWN)
        for sign in (1.0, -1.0):
            inputs = np.tile(self.inputs, GROWN)
            inputs[k] = np.clip(inputs[k] + sign * self.sigma[k] * np.repeat(grown, POSES), *self._ends(k))
            pose, left, errors = self._seen(inputs)
            raised = ((left * errors).sum(axis=0) > self.most**2).reshape(GROWN, POSES)
            quiet = np.vstack([np.ones((1, POSES), bool), ~np.logical_or.accumulate(raised)[:-1]])
            off = np.abs(self.d.difference(pose, right)).reshape(-1, GROWN, POSES)
            size = np.maximum(size, np.where(quiet, grown[:, None], 0.0).max(axis=0))
            moved = np.maximum(moved, np.where(quiet, off, 0.0).max(axis=1))
        return size, moved

    def _ends(self, k: int) -> tuple[float, float]:
        return self.d.ends(self.d.model.channels[k])

    @cached_property
    def _noise_of_pose(self) -> np.ndarray:
        return norm.isf(FALSE_ALARMS / 2) * np.sqrt((self.slopes[0] ** 2).sum(axis=0))

    @cached_property
    def _unseen(self) -> np.ndarray:
        """What a fault of the worst reading moves each coordinate by, with noise, by pose (pose, s)."""
        return np.asarray(self.faults[1].max(axis=0) + self._noise_of_pose)

    @cached_property
    def unseen(self) -> np.ndarray:
        """What a fault that grows moves each coordinate by before it raises a bit, with noise (pose,)."""
        return np.asarray(self._unseen.max(axis=1))

    def _stuck(self, values: Callable[[np.random.Generator, float, float], Any]) -> tuple[np.ndarray, ...]:
        """Whether readings (n,) that stick at `values` of their range raise no bit at poses drawn anywhere,
        (n, s), and whether that moves the pose by more than `unseen`."""
        rng, silent, far = np.random.default_rng(14), [], []
        inputs = self.drawn(rng, STUCK)
        right = self._seen(inputs)[0]
        for k, c in enumerate(self.d.model.channels):
            stuck = inputs.copy()
            stuck[k] = values(rng, *self.d.ends(c))
            pose, left, errors = self._seen(stuck)
            far.append((np.abs(self.d.difference(pose, right)) > self.unseen[:, None]).any(axis=0))
            silent.append((left * errors).sum(axis=0) <= self.limit)
        return np.array(silent), np.array(far)

    @cached_property
    def missed(self) -> float:
        """Share of readings that stick anywhere in their range, of poses drawn anywhere, that move the pose
        by more than that and raise no bit."""
        silent, far = self._stuck(lambda rng, low, high: rng.uniform(low, high, STUCK))
        return float((silent & far).mean())

    @cached_property
    def samples(self) -> int:
        """Samples at poses drawn anywhere of which one raises a bit in `SURE` of the cases, whichever reading
        is dead."""
        silent = self._stuck(lambda rng, low, high: np.clip(0.0, low, high))[0].mean(axis=1).max()
        return ceil(log(1 - SURE) / log(silent)) if 0 < silent < 1 else 1

    # -- without a suspect ---------------------------------------------------------------------------------

    def _others(self, k: int, i: int) -> tuple[np.ndarray, np.ndarray]:
        """With nothing left of watched k by reading i: slopes of the pose (n, pose, s), and the parts of the
        sum (n, s).

        The sum is bilinear in what is left and its factor: neither is computed again for all readings.
        """
        pose, left, errors = self.slopes
        own = left[i, k]
        counts = np.abs(own) > MASKED * np.abs(own).max()  # where it counts at all
        # by which the mended reading follows each other one, less
        share = np.where(counts, left[:, k] / np.where(counts, own, 1.0), 0.0)
        both = np.einsum("ms,nms->ns", left[i], errors) + np.einsum("nms,ms->ns", left, errors[i])
        return pose - pose[i] * share[:, None], self.seen - share * both + share**2 * self.seen[i]

    @cached_property
    def isolable(self) -> np.ndarray:
        """Whether each watched reading is isolable: confusable with no other (m,)."""
        out = []
        for k, one in enumerate(self.d.watched):
            isolable = bool(one.readings) and not one.error  # with it, confusable in some places
            for i in one.readings if isolable else ():
                rest, own = (np.delete(v, i, axis=0) for v in (self._others(k, i)[1], self.seen))
                isolable = isolable and bool((rest >= ISOLABLE * own)[own > MASKED * self.unit].all())
            out.append(isolable)
        return np.array(out)

    @property
    def _mended(self) -> list[tuple[int, int]]:
        """Numbers of what is watched and isolable, each with those of the readings it may be."""
        return [(int(k), i) for k in np.flatnonzero(self.isolable) for i in self.d.watched[k].readings]

    @cached_property
    def root(self) -> np.ndarray:
        """By which what is left of named readings is compared (k,): one over the root of its variance."""
        out = []
        for one, variance in zip(self.d.watched, (self.slopes[1] ** 2).sum(axis=0), strict=True):
            if not one.readings:
                continue
            counts = variance[variance > MASKED * self.unit]
            out.append(float(np.sqrt(self.unit / np.median(counts))) if len(counts) else 1.0)
        return np.where(self.isolable[: len(out)], out, -np.array(out))

    @cached_property
    def without(self) -> np.ndarray:
        """What a pose without its suspect may be off by (pose,), whichever of the isolable it is."""
        worst = np.zeros(len(self.d.pose))
        for k, i in self._mended:
            pose, seen = self._others(k, i)
            fault = self._unflagged(seen)
            fault[i] = 0.0
            moved = np.abs(pose) * fault[:, None]
            noise = norm.isf(FALSE_ALARMS / 2) * np.sqrt((pose**2).sum(axis=0))
            worst = np.maximum(worst, (moved.max(axis=0) + noise).max(axis=1))
        return worst

    @cached_property
    def redundancy(self) -> Redundancy:
        """The record of it."""
        d, mended = self.d, bool(self.isolable.any())
        without = named(d.pose, self.without + SAFE * self._mended_off()) if mended else {}
        return Redundancy(d.watched, mended, named(d.pose, self.unseen), without)

    def _mended_off(self) -> np.ndarray:
        """What is left (pose,) of a pose without noise by decoding it again without each reading."""
        d, worst = self.d, np.zeros(len(self.d.pose))
        for k, i in self._mended:
            found = without_reading(self._once, self.inputs, slice(None), i, k).pose
            worst = np.maximum(worst, np.abs(d.difference(found, self.at[0])).max(axis=1))
        return worst

    @property
    def said(self) -> tuple[str, ...]:
        """Sentences for header and report."""
        d, found = self.d, self.redundancy
        off = self.faults[0] * self.sigma[:, None]
        ends = dict.fromkeys(f"{float(f'{end:.2g}'):g}" for end in (off.min(), off.max()))
        out = [
            f"{counted(self.n, 'reading')} for {counted(len(d.pose), 'unknown')}: they are checked against "
            f"one another, with a false alarm in fewer than {FALSE_ALARMS:g} of the samples of the fit's "
            f"noise. A reading that is off by more than {' to '.join(ends)} {unit(d.model.channels[0])}, by "
            f"where it is, raises a bit in the same sample. One that drifts by less moves the {d.quantity}, "
            f"with the noise, by at most {_listed(found.unseen)}, at half of the places by less than "
            f"{_listed(named(d.pose, np.median(self._unseen, axis=1)))}."
        ]
        if not d.watched[0].error:  # of a board, a sensor that no array is over may be dead
            out.append(
                f"A dead reading raises a bit in {100 * SURE:g} % of the cases within "
                f"{counted(self.samples, 'sample')} at different places."
            )
        if self.missed > 0:
            out.append(
                f"Of readings that stick anywhere in their range {100 * self.missed:.2g} % happen to agree "
                f"with the others at another {d.quantity}: no bit is raised then, until the machine moves."
            )
        if found.mended:
            out.append(
                f"Without its suspect the {d.quantity} is off by at most {_listed(found.without)}; "
                "out->suspect is the number of that reading, from 1."
            )
        ambiguous = [w for w, known in zip(d.watched, self.isolable, strict=True) if w.readings and not known]
        if any(w.error for w in ambiguous):
            out.append(
                "Which readings count changes from place to place, so a suspect is named, and nothing is "
                "decoded without it."
            )
        elif ambiguous:
            groups = dict.fromkeys(tuple(sorted(w.readings)) for w in ambiguous)
            names = ["; ".join(", ".join(d.model.channels[i] for i in group) for group in groups)]
            out.append(
                f"A fault cannot be told from one of another reading, and nothing is decoded without it, of: "
                f"{names[0]}."
            )
        return tuple(out)


def _listed(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{value:.2g} {unit(c)} ({c})" for c, value in errors.items())


@dataclass(frozen=True, eq=False)
class Ran:
    """What the steps made of samples: pose (pose, s), bits of flags (s,), what is left (watched, s); suspects
    (s,) by number from 1, 0 where there is none.
    """

    pose: np.ndarray
    flags: np.ndarray
    left: np.ndarray
    suspects: np.ndarray


Once = Callable[[np.ndarray, Any], Ran]
"""Inputs and which samples they are of -> one pass of the steps, inputs brought back into their range."""


def checked(d: Decoupler, once: Once, clamped: np.ndarray, root: np.ndarray) -> Ran:
    """Return what `decoupler_step()` makes of inputs (n_inputs, s) in their range, suspects mended.

    `root` (watched,): in the numbers of the arithmetic, as what is left is.
    """
    first = once(clamped, slice(None))
    bad = np.flatnonzero(first.flags & d.fault_bit)
    if not len(bad):
        return first
    with np.errstate(all="ignore"):
        sizes = np.abs(first.left[: len(root), bad] * root[:, None])
    named_by = np.argmax(sizes, axis=0)
    pose, flags, suspects = first.pose.copy(), first.flags.copy(), first.suspects.copy()
    suspects[bad] = np.array([w.readings[0] + 1 for w in d.watched if w.readings], dtype=np.uint32)[named_by]
    for k in np.unique(named_by) if d.mends else ():
        own = bad[named_by == k]
        if root[k] > 0:
            again = _without(once, clamped[:, own], own, d.watched[k].readings, int(k))
            pose[:, own], suspects[own] = again.pose, again.suspects
            cleared = (again.flags & d.fault_bit) == 0
            flags[own] = np.where(cleared, again.flags | d.degraded_bit, again.flags)
    return Ran(pose, flags, first.left, suspects)


def _without(
    once: Once, clamped: np.ndarray, samples: np.ndarray, readings: Sequence[int], watched: int
) -> Ran:
    """Return a pass of the steps without the one of some readings that the others contradict least then."""
    best = without_reading(once, clamped, samples, readings[0], watched)
    best = replace(best, suspects=np.full(len(samples), readings[0] + 1, np.uint32))
    for i in readings[1:]:
        again = without_reading(once, clamped, samples, i, watched)
        better = sum(row * row for row in again.left) < sum(row * row for row in best.left)
        best = Ran(
            *(
                np.where(better, *pair)
                for pair in (
                    (again.pose, best.pose),
                    (again.flags, best.flags),
                    (again.left, best.left),
                    (i + 1, best.suspects),
                )
            )
        )
    return best


def without_reading(once: Once, clamped: np.ndarray, samples: Any, reading: int, watched: int) -> Ran:
    """Return a pass of the steps by the value of a reading at which nothing is left of it.

    Integers divide as C does, towards zero, and stay within 32 bits.
    """
    given, whole = clamped.copy(), clamped.dtype.kind == "i"
    value = np.zeros_like(clamped[0])
    before = last = value
    for n in range(SECANTS):
        given[reading] = value
        found = once(given, samples)
        now = found.left[watched]
        with np.errstate(all="ignore"):
            up, down = now * (value - before), now - last
            step = np.sign(up) * np.sign(down) * (abs(up) // np.maximum(abs(down), 1)) if whole else up / down
            # the first step takes what is left off the reading, the others go along the line through two
            first = np.full_like(now, -NUDGED) if whole else now
            step = first if n == 0 else np.where((now < last) | (now > last), step, now.dtype.type(0))
            before, last, value = value, now, value - step
            value = np.clip(value, -(2**31 - 1), 2**31 - 1) if whole else value
    return found


def fields_of(d: Decoupler) -> dict[str, Any]:
    """Return what templates say of the suspect: `numbers` of readings, in groups that begin at `starts`."""
    known = [w.readings for w in d.watched if w.readings]
    several = d.mends and max(map(len, known)) > 1
    groups = known if several else [readings[:1] for readings in known]
    return {
        "several": several,
        "named": len(known),
        "numbers": [i + 1 for readings in groups for i in readings],
        "starts": np.cumsum([0, *map(len, groups)]).tolist(),
        "secants": SECANTS,
        "nudged": NUDGED,
        "input_bits": flag_bit(len(d.flags) + d.mends - 1) - 1,
        "flag_bits": sum(flag_bit(k) for k in range(len(d.flags))),
    }
