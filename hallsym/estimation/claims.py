"""What a fit finds wrong with a recording: claims, each with its evidence and the correction that undoes it.

A mistake is tried as an effect is: the log without it is fitted again, and what that explains of the excess
over the noise floor decides. Mistakes of single runs are tried at the parameters of the other runs.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from itertools import combinations, groupby, islice, pairwise, permutations, product

import casadi as ca
import numpy as np
import scipy

from hallsym.errors import InputError
from hallsym.estimation.calibration import Claim, Fit
from hallsym.estimation.decoding import columns_of, logged_columns, residuals
from hallsym.estimation.factors import exact, program, summarise
from hallsym.estimation.goodness_of_fit import noise_followed
from hallsym.estimation.identifiable import determine
from hallsym.estimation.likelihood import Cost, cost_near, cost_of
from hallsym.estimation.optimum import NEWTON, SETTLING, closed_form, linear_fit, optimum, refit
from hallsym.estimation.task import noise_of, silent
from hallsym.families.recording import Correction, as_corrections, corrected_run, repeats, said, scales
from hallsym.log import Log, Noise
from hallsym.log.batches import batches
from hallsym.log.columns import RUN, is_moving, run_list
from hallsym.log.core import Block
from hallsym.log.derived import extended
from hallsym.log.estimate import estimate_noise
from hallsym.log.phase import as_continuous, continuous
from hallsym.log.quality.scan import is_noisy
from hallsym.log.table import joined
from hallsym.model import Model, Parameter, Signals
from hallsym.units import UNITS, si_unit
from solvers import bounded_step

SAMPLES = 8_000
"""Samples that a mistake is tried on: enough for parameters to a part in a hundred, and quickly fitted."""
FEW = 4_000
"""Readings of a model without run statistics, each pass over which costs as much as a fit of others."""
READ = 400_000
"""Samples that are read at most: corrections are made at the full rate, before samples are picked."""
CLOSELY = 1e-6
"""Share of the cost within which a trial is fitted: less than chance makes of it."""
STEPS_TRIED = 40
"""Newton steps of a trial: what needs more is far from right."""
MOST_NOISE = 0.05
"""Noise of a corrected column over its range, or its period, from which on it explains any residual."""


def claims_of(fit: Fit, given: Log) -> tuple[Claim, ...]:
    """Return what is wrong with the recording of a fit; `given`: the log as it was logged.

    Nothing is looked for where the model describes every run, and samples that it left out are anywhere.
    """
    if coarse := tuple(coarse_columns(given, fit)):
        return coarse
    fine = described(fit)
    ends = fine and _without_ends(fit)
    found = () if fine and not ends else mistakes_of(given, fit.model)
    return found or ((ENDS,) if ends else ())


ENDS = Claim(
    "ends", "The samples that were left out as spikes are the ends of runs, where no more spikes are than "
    "elsewhere: values that are means of neighbours, or come late, are off there, and between the ends too, "
    "where gains make up for it; record what each sample holds (--correct lists averaged and delay).",
)  # fmt: skip


def described(fit: Fit) -> bool:
    """Return whether the model describes every run."""
    goodness = fit.goodness
    return goodness is None or not (
        goodness.sentence or max(goodness.by_run.values(), default=1.0) ** 2 > ALONE
    )


BY_CHANCE = 1e-6
"""Probability that spikes lie at so many ends of runs, below which they are none."""


def _without_ends(fit: Fit) -> bool:
    """Return whether the samples that a fit left out as spikes are the ends of runs.

    There a mean has fewer neighbours, and what is late repeats its first value; a spike may be anywhere.
    """
    if fit.keep is None or fit.source is None:
        return False
    model = fit.model
    lost, lost_ends, samples, ends = 0, 0, 0, 0
    log = extended(continuous(fit.source, model), model, fit.noise.std, model.named(fit.values))
    for batch in batches(log, columns_of(model)):
        out = np.concatenate([fit.keep(block) == 0 for block in batch.blocks])
        at = sorted({place for _, part in batch.parts() for place in (part.start, part.stop - 1)})
        lost, lost_ends = lost + int(out.sum()), lost_ends + int(out[at].sum())
        samples, ends = samples + len(out), ends + len(at)
    return bool(scipy.stats.binom.sf(lost_ends - 1, lost, ends / samples) < BY_CHANCE)


LOOKED, RUNS_LOOKED = 4096, 8
"""Samples that are looked at for steps, and runs: a reading may be at rest in the first."""
FEW_CODES = 40
"""Values that a reading takes at most where its rounding is no noise: it repeats with the motion."""


def coarse_columns(given: Log, fit: Fit) -> Iterator[Claim]:
    """Yield the columns that take few values; what rounding does to them goes with the pose.

    A reference that is set takes few values too: it is coarse where its rounding is what was estimated as
    its noise, and the residual is no smaller.
    """
    model, noise = fit.model, fit.noise
    follows = fit.goodness is not None and EXCESS * fit.goodness.cost_per_degree_of_freedom < 1
    rounded = [] if follows else [c for c in model.references if noise[c].source != "given"]
    columns = tuple(dict.fromkeys((*model.channels, *rounded)))
    some = islice(given.blocks(columns, LOOKED), RUNS_LOOKED)
    for c, x in joined([block.data for block in some], columns).items():
        values = np.unique(x)
        step = _step_between(values) if len(values) <= min(FEW_CODES, len(x) / 4) else None
        if step is not None and (c in model.channels or EXCESS * 12 * noise[c].value ** 2 > step**2):
            yield Claim(
                "coarse_steps", f"{c} takes {len(values)} values only, in steps of {step:.4g}: what "
                "rounding does to it goes with the pose, and no fit tells it; use a finer converter.",
                (c,), correction=Correction("coarse_steps", (c,), (step,)).text,
            )  # fmt: skip


def _step_between(values: np.ndarray) -> float | None:
    """Return the step that all distances of ascending values are multiples of; None where there is none."""
    gaps = np.diff(values)
    gaps = gaps[gaps > 1e-9 * float(np.ptp(values))]
    if not len(gaps):
        return None
    step = float(gaps.min())
    return step if np.abs(gaps / step - np.round(gaps / step)).max() < EVEN else None


EVEN = 0.01
"""Part of a step by which values in even steps may be off."""


def mistakes_of(given: Log, model: Model) -> tuple[Claim, ...]:
    """Return the mistakes that explain what a model leaves of a log as it was logged, or why it fits none."""
    with np.errstate(all="ignore"):  # what is tried may be beyond numbers
        try:
            return tuple(dict.fromkeys(map(claim, suspects(Trials(given, model, noise_of(given, model))))))
        except (InputError, np.linalg.LinAlgError):
            return ()


def assigned(given: Log, model: Model) -> tuple[Correction, ...]:
    """Return how channels are exchanged and inverted, where that explains what a fit leaves; else nothing.

    Every order and sign of up to `ORDERED` channels is tried.
    """
    trials = Trials(given, model, noise_of(given, model))
    found: list[tuple[float, int, tuple[Correction, ...]]] = []
    with np.errstate(all="ignore"):
        base = trials.fitted()
        if base is None or not base.left or base.mean(base.left) < EXCESS or len(model.channels) > ORDERED:
            return ()
        for order in permutations(model.channels):
            for signs in product((1, -1), repeat=len(order)):
                wires = as_corrections(tuple(zip(order, signs, strict=True)), model.channels)
                after = trials.fitted(wires) if wires else None
                if after is not None and after.left and _explains(base, after):
                    found.append((round(after.mean(after.left), 2), len(wires), wires))
    return min(found, key=lambda one: one[:2])[2] if found else ()


ORDERED = 3
"""Channels whose orders and signs are tried, all of them: 48 of three."""


def claim(found: Found) -> Claim:
    """Return a mistake as a claim; without a correction where the log does not single one out."""
    c, rivals = found.correction, tuple(other.text for other in found.rivals)
    if not found.explains:
        odd = run_list(c.runs)
        text = (
            f"One calibration describes all runs but {odd}, and no mistake that was tried explains these: "
            f"look at what they hold, or leave them out of a fit with --holdout {odd}."
        )
        return Claim("odd_runs", text, runs=c.runs, rivals=(c.text,))
    if found.differs:
        what = "zero" if c.kind == "zero_moved" else "gain"
        text = f"The {what} of {c.columns[0]} is another one in each run: record it with one {what} for all."
        return Claim(c.kind, text, c.columns)
    share = f"explains {100 * found.explains:.0f} % of what the model leaves"
    also = f"; {_listed(rivals)} would do as well" if rivals else ""
    factors = sorted(
        other.numbers[0] for other in (c, *found.rivals) if c.kind == "scale" and _same(other, c)
    )
    if len(factors) > 2:
        also = f"; factors from {factors[0]:.4g} to {factors[-1]:.4g} would do as well"
    remedy = f"undo it with --correct '{c.text}'"
    if not found.single:
        remedy = "each gives another calibration, so state the one that the recorder tells with --correct"
        rivals = (c.text, *rivals)
    text = f"{said(c)[0].upper()}{said(c)[1:]}: that {share}{also}; {remedy}."
    return Claim(c.kind, text, c.columns, c.runs, c.text if found.single else None, found.explains, rivals)


def _listed(texts: Sequence[str]) -> str:
    return f"'{texts[0]}'" + (f" (and {len(texts) - 1} more)" if len(texts) > 1 else "")


# -- what is tried -----------------------------------------------------------------------------------------

WIDE = tuple(10.0**n for n in (-5, -3, -1, 1, 3, 5))
"""Scales that are tried first; those within two decades of the best follow, and of a better one."""
STEPS = {"delay": (-24, -12, -6, -1, 1, 6, 12, 24), "averaged": (2, 6, 16)}
"""Samples of delays and of centred means that are tried before those between them and the best."""


def groups(
    model: Model, columns: Sequence[str], worst: Sequence[str]
) -> tuple[list[tuple[str, ...]], list[tuple[str, ...]]]:
    """Return columns that one device writes, and those that one setting may change.

    A device writes one, all readings, all references, or these and the state; a setting changes these too,
    and all columns of a unit, without readings and with them. `worst`: the readings that are looked at one
    by one.
    """
    readings, references = ([c for c in some if c in columns] for some in (model.channels, model.references))
    logged = [*references, *(c for c in model.state if c in columns)]
    together = [tuple(some) for some in (readings, references, logged) if some]
    each = [*((c,) for c in (*logged, *worst)), *together]
    of_unit = [
        tuple(c for c in some if si_unit(c) == unit)
        for unit in dict.fromkeys(map(si_unit, logged)) for some in (logged, [*readings, *logged])
    ]  # fmt: skip
    return list(dict.fromkeys(each)), list(dict.fromkeys([*each, *of_unit]))


def _scaled(model: Model, columns: tuple[str, ...]) -> list[Correction]:
    return [Correction("scale", columns, (factor,), unit=unit) for unit, factor in scales(model, columns)]


def hypotheses(model: Model, columns: Sequence[str], worst: Sequence[str]) -> Iterator[Correction]:
    """Yield the mistakes that all samples of some runs may have, the plainest first.

    `worst`: the readings that are looked at one by one.
    """
    each, settings = groups(model, columns, worst)
    yield from (Correction("sign", g) for g in settings)
    for g in settings:
        around = {*model.period} & {*g}  # of what goes round each factor is another one
        yield from (c for c in _scaled(model, g) if around or any(np.isclose(c.numbers[0], f) for f in WIDE))
    logged = [g[0] for g in each if len(g) == 1 and g[0] not in model.channels]
    yield from (Correction("exchange", pair) for pair in combinations(logged, 2))
    yield from (Correction("exchange", pair) for pair in combinations(worst, 2))
    for g in each:
        yield from (Correction(kind, g, (float(n),)) for kind, steps in STEPS.items() for n in steps)


# -- how it is tried ---------------------------------------------------------------------------------------


@dataclass(eq=False)
class Trials:
    """A log in which corrections are tried: columns of whole runs as they were logged, and samples picked."""

    given: Log
    model: Model
    noise: Noise
    _last: dict[object, Log] = field(default_factory=dict, init=False)
    _noise: dict[str, dict[int, float]] = field(default_factory=dict, init=False)

    @cached_property
    def columns(self) -> tuple[str, ...]:
        """What the model reads, and time."""
        logged = dict.fromkeys((*logged_columns(self.model), "t_s"))
        return tuple(c for c in logged if c in self.given.columns)

    @cached_property
    def spans(self) -> list[tuple[int, slice]]:
        """The runs that are read, of a long log evenly taken, and where they lie in `full`."""
        found = [(b.run, len(b.data[self.columns[0]])) for b in self._blocks]
        ends = np.cumsum([0, *(n for _, n in found)]).tolist()
        return [(run, slice(a, b)) for (run, _), a, b in zip(found, ends, ends[1:], strict=False)]

    @cached_property
    def _blocks(self) -> list[Block]:
        runs = {*self.given.runs[:: -(-self.given.rows // READ)]}
        each = groupby(self.given.blocks(self.columns), lambda block: block.run)
        return [Block(k, joined([b.data for b in own], self.columns)) for k, own in each if k in runs]

    @cached_property
    def full(self) -> dict[str, np.ndarray]:
        """The columns of these runs."""
        return dict(joined([b.data for b in self._blocks], self.columns))

    def quieter(self, c: Correction, runs: Sequence[int]) -> float:
        """Return the deviance per reading by which references and states lack noise in some runs.

        One device has one noise: a column that is quieter in these runs than in any other was in no other
        unit, and holds no other column's values. Of a whole log, and of columns without noise, none tell.
        """
        if len(runs) == len(self.spans):
            return 0.0
        lacks, samples = 0.0, {run: at.stop - at.start for run, at in self.spans if run in runs}
        for name, (source, factor) in c.mistake.sources(c).items():
            if name in self.model.channels:
                continue
            usual = [sigma for run, sigma in self._noise_by_run(name).items() if run not in samples and sigma]
            noise = self._noise_by_run(source)
            for run in samples.keys() & noise if usual else ():
                if noise[run] > 0:
                    ratio = min(abs(factor) * noise[run] / min(usual), 1.0) ** 2
                    lacks += samples[run] * (ratio - 1 - np.log(ratio))
        return lacks / max(sum(samples.values()) * len(self.model.channels), 1)

    def _noise_by_run(self, column: str) -> dict[int, float]:
        """Return the noise of a column, estimated in each run by itself, of those that show it."""
        if column not in self._noise:
            found = self._noise[column] = {}
            for run, at in self.spans:
                part = {RUN: self.run[at], column: self.full[column][at]}
                with suppress(InputError):
                    found[run] = estimate_noise(Log.from_arrays(part), (column,))[column].value
        return self._noise[column]

    @cached_property
    def run(self) -> np.ndarray:
        """The run of each sample."""
        return np.concatenate([np.full(at.stop - at.start, run) for run, at in self.spans])

    def log(self, corrections: Sequence[Correction] = (), runs: Sequence[int] | None = None) -> Log:
        """Return the samples that are tried, of some runs, without mistakes; the last are kept."""
        key = tuple(corrections), runs and tuple(runs)
        if key not in self._last:
            arrays, noise = self.samples(corrections, runs)
            self._last = {key: as_continuous(Log.from_arrays(arrays, noise, self.given.meta))}
        return self._last[key]

    def samples(
        self, corrections: Sequence[Correction], runs: Sequence[int] | None
    ) -> tuple[dict[str, np.ndarray], Noise]:
        """Return the columns of these samples, and their noise."""
        own = runs is not None and not {*self.model.period} & {*self.model.channels}
        spans = [(r, at) for r, at in self.spans if r in runs] if own and runs else self.spans
        touched = [c for one in corrections for c in one.columns if c in self.full] or self.columns[:1]
        done = [corrected_run(Block(run, {c: self.full[c][at] for c in touched}), corrections)
                for run, at in spans]  # fmt: skip
        columns = (
            self.full
            if spans is self.spans
            else {c: np.concatenate([v[at] for _, at in spans]) for c, v in self.full.items()}
        )
        columns = {**columns, **joined([data for data, _ in done], touched)}
        keep = np.concatenate([
            np.ones(at.stop - at.start, bool) if stays is None else stays
            for (_, at), (_, stays) in zip(spans, done, strict=True)
        ])  # fmt: skip
        run = np.concatenate([self.run[at] for _, at in spans])
        noise = self.noise
        for one in corrections:
            noise = one.noise_of(noise, runs)
        if self.model.period:  # turns are counted at the full rate
            log = continuous(Log.from_arrays({RUN: run, **columns}, noise, self.given.meta), self.model)
            columns = {c: log.array(c) for c in self.columns}
        for c in {c for one in corrections for c in one.columns if c in noise}:
            reach = max(float(np.ptp(columns[c])), float(np.ptp(self.full[c])) if own else 0.0)
            if noise[c].value > MOST_NOISE * min(reach, self.model.period.get(c, np.inf)):
                raise InputError(f"Column {c} would hold noise alone; leave that correction out.")
        wanted = keep if runs is None else keep & np.isin(run, list(runs))
        few = SAMPLES if exact(self.model) else max(FEW // len(self.model.channels), 1)
        every = max(1, int(wanted.sum()) // few)
        late = np.concatenate([np.arange(k, k + at.stop - at.start) for k, (_, at) in enumerate(spans)])
        pick = np.flatnonzero(wanted & (late % every == 0))  # ends of runs are seen in some
        if not len(pick):
            raise InputError("No sample would be left; leave that correction out.")
        return {RUN: run[pick], **{c: v[pick] for c, v in columns.items()}}, noise

    def fitted(
        self,
        corrections: Sequence[Correction] = (),
        runs: Sequence[int] | None = None,
        *,
        closely: bool = True,
    ) -> Tried | None:
        """Fit the log without mistakes; None where that fails.

        Not `closely`: where the fit begins, all runs as one.
        """
        try:
            return self._fitted(tuple(corrections), runs, closely)
        except (InputError, np.linalg.LinAlgError):
            return None

    def _fitted(
        self, corrections: tuple[Correction, ...], runs: Sequence[int] | None, closely: bool
    ) -> Tried | None:
        log = self.log(corrections, runs)
        if not (self.model.offsets or self.model.computed or (closely and exact(self.model))):
            arrays = {
                RUN: np.zeros(log.rows),
                **{c: log.array(c) for c in self.columns},
            }  # one run is quicker
            log = as_continuous(Log.from_arrays(arrays, log.noise, log.meta))
        if not exact(self.model):
            guess, noise = self.model.guess, noise_of(log, self.model).std
            begin = self.model.vector(guess(self.model, log)) if guess else self.model.nominal
            state = optimum(log, self.model, noise, begin, (), None, silent, NEWTON)
            return self.at(corrections, state.p, runs)
        summary = summarise(log, self.model)
        merged = cost_of(summary.merged(), log.noise.std)
        first = np.clip(closed_form(merged, linear_fit(merged)), *self.model.bounds)
        if not closely:
            return Tried(corrections, merged, first, self.model, log)
        found = determine(merged, first)
        first, fixed = found.begin(self.model, first), found.not_free
        p = refit(merged, first, fixed, CLOSELY, STEPS_TRIED) if len(fixed) < len(first) else first
        return Tried(corrections, cost_of(summary, log.noise.std), p, self.model, log)

    def at(
        self, corrections: Sequence[Correction], p: np.ndarray, runs: Sequence[int] | None
    ) -> Tried | None:
        """Judge some runs without mistakes at parameters (n,)."""
        try:
            log = self.log(corrections, runs)
            rounds = SETTLING if self.model.offsets else 1
            cost = cost_near(log, self.model, p, log.noise.std, rounds=rounds)
            return Tried(tuple(corrections), cost, p, self.model, log)
        except (InputError, np.linalg.LinAlgError):
            return None


@dataclass(frozen=True, eq=False)
class Tried:
    """A log without mistakes, and the parameters that it was judged by.

    `log`: with these runs, or more.
    """

    corrections: tuple[Correction, ...]
    cost: Cost
    p: np.ndarray
    model: Model
    log: Log

    def __post_init__(self) -> None:
        """Raise `LinAlgError` where the noise is beyond numbers."""
        self.cost.at(self.p)

    @property
    def squares(self) -> np.ndarray:
        """Squares of the whitened residual by run; rounding leaves some below 0 of numbers out of range."""
        return np.abs(self.cost.at(self.p).run_values)

    @cached_property
    def left(self) -> dict[int, float]:
        """Mean square of the whitened residual by run: 1 is noise; none where the noise is beyond numbers."""
        counts = self.cost.summary.counts * len(self.model.channels)
        try:
            values = self.squares / np.maximum(counts - len(self.model.offsets), 1.0)
        except np.linalg.LinAlgError:
            return {}
        return dict(zip(self.cost.summary.runs, values.tolist(), strict=True))

    @cached_property
    def deviance(self) -> dict[int, float]:
        """Twice the negative logarithm of the likelihood of the logged readings, by run and per reading.

        A reading that is scaled is less likely by the factor, by as much as its noise is less.
        """
        point, summary, K = self.cost.at(self.p), self.cost.summary, len(self.model.channels)
        _, size = np.linalg.slogdet(point.covariance)
        values = self.squares / np.maximum(summary.counts, 1.0) + size
        for one in self.corrections:
            readings = sum(c in self.model.channels for c in one.columns)
            values = values - 2 * np.log(abs(one.mistake.factor(one))) * readings
        return dict(zip(summary.runs, (values / K).tolist(), strict=True))

    def rest(self, after: Tried | None) -> float:
        """Return the share of what is left, squares over the noise, that is left after a correction.

        All of it where a delay or a mean keeps few samples.
        """
        if after is None or not after.left:
            return np.inf
        if _too_few(after.corrections, sum(after.counts.values()), sum(self.counts.values())):
            return np.inf
        return after.mean(after.left) / max(self.mean(self.left), 1e-300)

    @cached_property
    def within(self) -> np.ndarray:
        """Variance of readings within each run, (runs, readings).

        Of one that repeats, a phase at random's at most: the turns that it is given are its reference's.
        """
        log, model = self.log, self.model
        run = log.array(RUN)
        starts = np.flatnonzero(np.diff(run, prepend=np.nan))
        counts = np.diff([*starts, len(run)])[:, None]
        x = np.stack([log.array(c) for c in model.channels], axis=1)
        x = x - np.repeat(np.add.reduceat(x, starts) / counts, counts[:, 0], axis=0)
        most = [model.period.get(c, np.inf) ** 2 / 12 for c in model.channels]
        return np.asarray(np.minimum(np.add.reduceat(x**2, starts) / counts, most))

    @cached_property
    def shares(self) -> np.ndarray:
        """Shares of a reading's variance within a run: what is left, what is noise, (2, readings).

        Mean over runs; of one in which a reading is at rest, its variance in the others counts.
        """
        counts, within = self.cost.summary.counts[:, None], self.within * self.cost.summary.counts[:, None]
        usual = counts * within.sum(axis=0) / max(float(counts.sum()), 1.0)
        total = np.maximum(np.maximum(within, usual), 1e-300)
        point = self.cost.at(self.p)
        left = np.einsum("rkk->rk", point.squares)
        noise = counts * np.einsum("rkk->rk", point.covariance)
        return np.array([(part / total).mean(axis=0) for part in (left, noise)])

    def worst(self, runs: Sequence[int]) -> list[str]:
        """Return the readings that leave most over their noise in some runs, `SEARCHED` at most, in order."""
        some = np.isin(self.cost.summary.runs, list(runs))
        point = self.cost.at(self.p)
        over = np.einsum("rkk->rk", point.squares)[some].sum(axis=0)
        over = over / np.einsum("rkk->rk", point.covariance)[some].mean(axis=0)
        first = set(np.argsort(-over)[:SEARCHED].tolist())
        return [c for k, c in enumerate(self.model.channels) if k in first]

    @cached_property
    def counts(self) -> dict[int, float]:
        """Samples by run."""
        return dict(zip(self.cost.summary.runs, self.cost.summary.counts.tolist(), strict=True))

    def mean(self, of: Mapping[int, float], runs: Sequence[int] | None = None) -> float:
        """Return the mean over samples of what runs have."""
        some = [r for r in of if runs is None or r in runs]
        weights = np.array([self.counts[r] for r in some])
        return float(weights @ np.array([of[r] for r in some]) / max(weights.sum(), 1.0))


def _too_few(corrections: Sequence[Correction], kept: float, of: float) -> bool:
    """Return whether delays or means keep few of so many samples."""
    return kept <= KEEPS * of and any(one.kind in STEPS for one in corrections)


Screen = Callable[[Sequence[Correction]], Mapping[Correction, float]]


def _screen(trials: Trials, base: Tried, runs: Sequence[int], *, free: bool) -> Screen:
    """Return a function of the shares of the residual that corrections leave in some runs, without a fit.

    `free`: at parameters of their own: where a fit begins, the optimum of the tangent at `base`, or, as no
    tangent knows offsets of runs where no reading follows, of a few runs. Else at those of `base`.
    """
    model = trials.model
    if free and (exact(model) or model.offsets or model.computed):
        few = None if exact(model) else runs[:: -(-len(runs) // FEWEST)]
        first = trials.fitted((), few) if few else base
        return lambda many: {
            c: first.rest(trials.fitted((c,), few, closely=False)) if first else np.inf for c in many
        }
    if model.computed or (model.offsets and not exact(model)):
        return lambda many: {c: base.rest(trials.at((_of(c, runs),), base.p, runs)) for c in many}
    return _on_tangents(trials, base.p, runs, free=free)


AT_ONCE = 2048
"""Samples whose tangents are computed at once: so many that the numbers take longer than the calls."""


def _on_tangents(trials: Trials, p: np.ndarray, runs: Sequence[int], *, free: bool) -> Screen:
    """Return the same on the tangents of samples at `p` (n,), which many corrections share.

    `free`: the parameters move, else the offsets of runs. Triangles of many readings hold more numbers than
    few samples do. The noise of logged columns enters a residual as it does without a correction.
    """
    model, parts = trials.model, program(trials.model)
    logged, K, z = (*model.references, *model.state), len(model.channels), len(model.offsets)
    low, high = (b - p for b in model.bounds) if free else np.outer((-np.inf, np.inf), np.ones(z))
    k, j = np.array(parts.entries if free else parts.zero_entries, dtype=int).reshape(-1, 2).T
    moving = slice(free * len(parts.zero_entries), free * len(parts.zero_entries) + len(k))

    def read(data: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        """Return readings (K, samples), and their slopes with what moves, (K, unknowns, samples)."""
        pose, state = ([data[c] for c in some] for some in (model.references, model.state))
        rows = parts.values(p, np.zeros((z, len(data[RUN]))), pose, state)[0]
        slopes = np.zeros((K, len(low), rows.shape[1]))
        slopes[k, j] = rows[moving]
        return rows[-K:], slopes

    def spread(c: str) -> np.ndarray:
        """Return the mean product of the slopes of readings with a column, (K, K)."""
        h = 1e-3 * float(np.ptp(plain[c])) or 1e-9
        slope = (read({**plain, c: plain[c] + h})[0] - read(plain)[0]) / h
        return np.asarray(slope @ slope.T / slope.shape[1])

    def whitening(noise: Noise) -> np.ndarray:
        own = np.diag([noise[c].value ** 2 for c in model.channels])
        return np.linalg.inv(np.linalg.cholesky(own + sum(noise[c].value ** 2 * by[c] for c in by)))

    def left(many: Sequence[tuple[Mapping[str, np.ndarray], np.ndarray]]) -> np.ndarray:
        """Return the mean square of the whitened residual of samples, of each (samples, whitening)."""
        data = joined([data for data, _ in many], (RUN, *logged, *model.channels))
        counts = [len(own[RUN]) for own, _ in many]
        log = np.repeat(np.arange(len(many)), counts)
        new = (np.diff(log, prepend=-1) != 0) | ((not free) & (np.diff(data[RUN], prepend=0) != 0))
        expected, slopes = read(data)
        rest, squares = np.stack([data[c] for c in model.channels]) - expected, np.zeros(len(many))
        for at in (slice(a, b) for a, b in pairwise([*np.flatnonzero(new), len(log)])):
            whiten = many[log[at.start]][1]
            e = (whiten @ rest[:, at]).ravel()
            J = np.swapaxes(np.tensordot(whiten, slopes[:, :, at], 1), 0, 1).reshape(len(low), e.size)
            squares[log[at.start]] += e @ e
            if np.isfinite(H := J @ J.T).all() and np.isfinite(e @ e):
                squares[log[at.start]] -= 2 * bounded_step(-J @ e, H, low, high)[1]
        fitted = 0 if free else z * np.bincount(log[new])
        return np.asarray(squares / np.maximum(np.array(counts) * K - fitted, 1))

    plain, noise = trials.samples((), runs)
    by = {c: spread(c) for c in logged if c in noise}
    usual, samples = left([(plain, whitening(noise))])[0], len(plain[RUN])

    def screened(many: Sequence[Correction]) -> dict[Correction, float]:
        found, out, size = [], dict.fromkeys(many, np.inf), max(1, AT_ONCE // samples)
        for c in many:
            with suppress(InputError, np.linalg.LinAlgError):
                data, noise = trials.samples((c if free else _of(c, runs),), runs)
                if not _too_few((c,), len(data[RUN]), samples):
                    found.append((c, data, whitening(noise)))
        for some in (found[n : n + size] for n in range(0, len(found), size)):
            shares = left([(data, whiten) for _, data, whiten in some]) / max(usual, 1e-300)
            out |= {c: share for (c, *_), share in zip(some, shares.tolist(), strict=True) if share >= 0}
        return out

    return screened


# -- what is found -----------------------------------------------------------------------------------------

EXPLAINS = 0.9
"""Share of the excess that a correction must explain to be named: one that leaves a tenth of it is near the
right one, not it."""
CUT_OFF = 4.0
"""Mean square that steps leave over step^2/12, at most: of numbers cut off, not rounded, step^2/3."""
EXCESS = 1.5
"""Mean square of the residual over the noise from which on a mistake is looked for: a noise that is stated
20 % too small is none."""
ALONE = 3.0
"""Mean square over that of the other runs from which on a run is looked at by itself."""
FEWEST = 4
"""Runs from which on some can be judged by the others."""
ROUNDS = 8
"""Of finding the runs that agree, and of finding the size of a step, at most."""
SETTLED = 1e-3
"""Part of a size by which a round may still change it."""
RIVAL = 20.0
"""Difference of the deviance, of all readings, up to which two corrections explain as much."""
NEAR = 0.02
"""The same of each reading, over what is left: where effects are left too, chance is not all that decides."""
KEEPS = 0.6
"""Share of the samples that a delay or a mean must keep: half a wave of what moves is a sign as well."""
CHANCE = 2.0
"""Standard deviations of the mean square of noise: corrections that keep other samples differ by chance."""
DIFFERENT = 3
"""Mistakes of runs that are named in one log, at most."""


@dataclass(frozen=True, eq=False)
class Found:
    """A correction, what it explains of the excess, and those that explain as much.

    `single`: whether none of those that assume no more gives another calibration.
    """

    correction: Correction
    explains: float
    rivals: tuple[Correction, ...] = ()
    single: bool = True
    differs: bool = False
    """Whether the other runs want such a step each too, of another size."""


def suspects(trials: Trials) -> list[Found]:
    """Return the mistakes that explain what a model leaves of a log; none where it leaves noise."""
    base = trials.fitted()
    if base is None or not base.left or max(base.left.values()) < EXCESS:
        return []
    runs = list(base.left)
    best = _best(trials, base, lambda c: trials.fitted((c,)), _screen(trials, base, runs, free=True), runs)
    after = trials.fitted((best.correction,)) if best else None
    if not best or not after or not _explains(base, after):
        return _of_some_runs(trials, base)
    if after.mean(after.left) < EXCESS:
        return [best]
    some = [one for one in _of_some_runs(trials, base) if one.explains]
    fits = trials.fitted([one.correction for one in some]) if some else None  # of one run is nearly of all
    return some if fits and fits.mean(fits.deviance) < after.mean(after.deviance) else [best]


def _of_some_runs(trials: Trials, base: Tried) -> list[Found]:
    """Return the mistakes of runs that others do not foresee.

    Of several ways to divide the runs the one with the fewest mistakes, then the likeliest. Where none is
    explained, few runs that no others foresee, which explain nothing. The noise is that of the runs that
    agree.
    """
    divided = _divisions(trials, base)
    noise = (noise_followed(one.log, one.cost.at(one.p), trials.noise) for one in divided.values())
    if known := next(filter(None, noise), None):
        trials = replace(trials, noise=known)
        base = trials.fitted() or base
        divided = _divisions(trials, base)
    may_stay = (1 - EXPLAINS) * _excess(base)
    explained: list[tuple[int, float, list[Found]]] = []
    for odd, agreed in divided.items():
        if _excess(agreed) > may_stay:  # no mistake of other runs lowers it
            continue
        some = _in_runs(trials, agreed, odd)
        after = trials.fitted([one.correction for one in some]) if some else None
        if after is not None and after.left and _explains(base, after):
            explained.append((len(some), after.mean(after.deviance), some))
    few = (odd for odd, agreed in divided.items() if len(odd) <= DIFFERENT and _excess(agreed) <= may_stay)
    if not explained and (odd := min(few, key=len, default=())):
        return [Found(Correction("other_device", runs=odd), 0.0)]
    found = min(explained, key=lambda one: one[:2], default=(0, 0.0, []))[2]
    every = (one.correction for *_, some in explained for one in some)
    devices = [c for c in every if c.kind == "other_device"]  # it may be each of these
    return [
        replace(one, rivals=tuple(c for c in devices if c != one.correction), single=len(devices) == 1)
        if one.correction in devices else one
        for one in found
    ]  # fmt: skip


def _excess(tried: Tried) -> float:
    """Return the squares that are left over the noise, and over `CHANCE`."""
    samples = sum(tried.counts[r] for r in tried.left)
    chance = CHANCE * (2 / max(samples * len(tried.model.channels), 1)) ** 0.5
    return samples * (tried.mean(tried.left) - 1 - chance)


def _explains(base: Tried, after: Tried) -> bool:
    """Return whether a log without mistakes, fitted again, shows that they were what was wrong."""
    gain = base.mean(base.deviance) - after.mean(after.deviance)
    over = max(_excess(after), 0.0) / max(sum(after.counts[r] for r in after.left), 1.0)
    return gain >= EXPLAINS * (gain + over) and _follows(base, after)


def _follows(base: Tried, after: Tried) -> bool:
    """Return whether each reading follows the references better: one that is scaled down leaves less too."""
    if all(one.mistake.keeps for one in after.corrections):
        return True
    (before, noise), (left, noise_after) = base.shares, after.shares
    moved = np.minimum(noise, noise_after) < AT_REST
    if not moved.any():
        return False
    most = (1 - EXPLAINS) * before[moved].mean() + 2 * noise[moved].mean()
    return bool(left[moved].mean() <= min(most, UNEXPLAINED + 2 * noise_after[moved].mean()))


AT_REST = 0.04
"""Share of a reading's variance that is noise, from which on it does not tell whether it follows."""
UNEXPLAINED = 0.003
"""Share of the readings' variance that effects may leave beside a mistake, over the noise: a twentieth of the
stroke."""


def _divisions(trials: Trials, base: Tried) -> dict[tuple[int, ...], Tried]:
    """Return runs that others do not foresee, with the fit of those others: the ways to divide a log.

    The others, half of the runs at least, are described equally well by one set of parameters. They are found
    by least trimmed squares from all runs but the worst, and from the first and the last half: the half that
    is described best is fitted again, and all that it foresees with it, until they stay.
    """
    runs, out, known = list(base.left), dict[tuple[int, ...], Tried](), set[tuple[int, ...]]()
    half = (len(runs) + 1) // 2
    others = sorted(runs, key=base.left.__getitem__)[:-1]
    for begin in (sorted(others), runs[:half], runs[-half:]) if len(runs) >= FEWEST else ():
        some, agreed = begin, list[int]()
        for _ in range(ROUNDS):
            if tuple(some) in known:  # they stay, or come round again
                break
            known.add(tuple(some))
            again = trials.fitted((), some)
            seen = again and trials.at((), again.p, runs)
            if not seen or not seen.left:
                break
            best = sorted(runs, key=seen.left.__getitem__)[:half]
            usual = max(float(np.median([seen.left[r] for r in best])), 1.0)
            agreed = [r for r in runs if seen.left[r] < EXCESS * usual]
            described = len(agreed) >= half and seen.mean(seen.left, agreed) < EXCESS
            some = agreed if described else sorted(best)
        fit = trials.fitted((), agreed) if len(runs) > len(agreed) >= half else None
        rest = fit and trials.at((), fit.p, [r for r in runs if r not in agreed])
        if not fit or not rest:
            continue
        # of parameters that are not known exactly a run may show more than when it is fitted with the others
        near = [r for r, left in rest.left.items() if left < ALONE]
        again = trials.fitted((), sorted((*agreed, *near))) if near else None
        fit = again if again and max(again.left.values(), default=np.inf) < EXCESS else fit
        if odd := tuple(r for r in rest.left if r not in fit.left):
            out[odd] = fit
    return out


@dataclass(frozen=True, eq=False)
class Judged:
    """A correction that was tried: the deviance per reading before and after, and the mean square it leaves.

    Before: of the samples that the correction leaves.
    """

    before: float
    after: float
    left: float
    correction: Correction

    @property
    def gain(self) -> float:
        """The deviance that it gains."""
        return self.before - self.after

    @property
    def explains(self) -> float:
        """The share of the excess."""
        over = self.left - min(self.left, 1.0)
        return self.gain / max(self.gain + over, 1e-300)

    @property
    def plain(self) -> tuple[int, int]:
        """How much it assumes: numbers that were searched, columns."""
        c = self.correction
        numbers = c.numbers or (0.0,) * len(c.mistake.numbers)
        return (0 if c.unit else sum(map(np.isfinite, numbers))), len(c.columns)


def _best(
    trials: Trials,
    base: Tried,
    tried: Callable[[Correction], Tried | None],
    screened: Screen,
    runs: Sequence[int],
) -> Found | None:
    """Return the mistake that explains the excess of `base` in some runs best; None where none does.

    `screened`: the shares of what is left that corrections leave about; the best are `tried`.
    """
    before = base.mean(base.deviance, runs)
    seen: list[Judged] = []
    shares: dict[Correction, float] = {}

    def deviance(c: Correction) -> float:
        found = tried(c)
        return found.mean(found.deviance, runs) if found is not None and found.left else np.inf

    @cache
    def without_ends(samples: int) -> float:
        """Return the deviance without three times as many samples at either end, as the others are."""
        value = deviance(Correction("averaged", numbers=(2.0 * samples,)))
        return value if np.isfinite(value) else before

    def judge(c: Correction) -> None:
        """Try a correction."""
        found = tried(c)
        if found is None or not found.left or not np.isfinite(base.rest(found)) or not _follows(base, found):
            return
        left = found.mean(found.left, runs)
        if c.mistake.keeps and left > CUT_OFF:  # a noise that is larger is not all that is wrong
            return
        n = abs(round(c.numbers[0])) if c.kind in STEPS else 0
        touched = max(n // 2 if c.kind == "averaged" else -(-n // 3), 1)  # a third of them, at either end
        same = without_ends(touched) if n else before
        inside = _inside(trials, found, c, runs) if c.kind == "clipped" else 0.0
        after = found.mean(found.deviance, runs) + inside + trials.quieter(c, runs)
        one = Judged(same, after, left + inside, c)
        if np.isfinite(one.gain):
            seen.append(one)

    def searched(one: Judged) -> bool:  # a factor that was searched assumes most
        return one.correction.kind == "scale" and one.correction not in shares

    def assumes(one: Judged) -> tuple[bool, tuple[int, int], int]:  # of units the most usual
        unit = one.correction.unit
        return searched(one), one.plain, [*UNITS].index(unit) if unit else 0

    def chosen() -> tuple[list[Judged], Judged, float]:
        """Return those that explain as much as the best, that of them which assumes least, and how near."""
        good = [one for one in seen if _good(one)]
        best = min(good, key=lambda one: one.after)
        close = _close(base, runs, best.left)
        equal = [one for one in good if one.after - best.after < close]
        return equal, min(equal, key=lambda one: (assumes(one), one.after)), close

    more = [
        *hypotheses(trials.model, trials.columns, base.worst(runs)), *of_samples(trials, base)
    ]  # fmt: skip
    while more:
        shares |= screened(more)
        more = _closer(trials.model, shares)
    for c in (c for own in _closest(shares) for c in own[:NUMBERS]):
        judge(c)
    named = min(filter(_good, seen), key=lambda one: one.after, default=None)
    if not named or named.correction.kind == "scale" or named.left >= EXCESS:
        scaled = (c for c in shares if c.kind == "scale")
        about = min(scaled, key=shares.__getitem__, default=None)
        if named and named.correction.kind == "scale":
            about = named.correction
        if about and not {*trials.model.period} & {*about.columns}:
            c = _least(about, deviance)
            # else near enough to 1 for a wavelength or a scale of the machine
            if abs(np.log(abs(c.numbers[0]))) > np.log(ALTERED):
                judge(c)
    if not any(map(_good, seen)):
        return None
    equal, first, close = chosen()
    if first.correction.kind == "scale" and not first.correction.unit:  # no screen distinguishes decades
        judged = {one.correction for one in seen}
        for c in (c for c in shares if _same(c, first.correction) and c not in judged):
            judge(c)
        equal, first, close = chosen()
    if searched(first):  # how far the factor may be off, either way
        for ratio, n in product((1 + KNOWN, 1 - KNOWN), range(FAR)):
            judge(replace(first.correction, numbers=(first.correction.numbers[0] * ratio ** (2**n),)))
        equal, first, close = chosen()
    at = tried(first.correction)

    def differs(one: Judged) -> bool:
        """Return whether the calibration of the first does not describe the log without the other mistake."""
        own = tried(one.correction)
        if not at or not own or np.array_equal(own.p, at.p):
            return False
        found = trials.at((one.correction,), at.p, runs)
        return not found or not found.left or found.mean(found.deviance) - own.mean(own.deviance) > close

    others = [one for one in equal if one is not first and (searched(first) or not searched(one))]
    other = {one.correction for one in others if differs(one)}
    rivals = tuple(
        one.correction for one in others
        if one.correction in other or not _same(one.correction, first.correction)
    )  # fmt: skip
    single = not any(one.correction in other and assumes(one) == assumes(first) for one in others)
    return Found(first.correction, min(first.explains, 1.0), rivals, single)


def _close(base: Tried, runs: Sequence[int], left: float) -> float:
    """Return by how much deviances of a reading may differ between corrections that do as well."""
    samples = max(sum(base.counts[r] for r in runs), 1.0)
    return float(max(RIVAL / samples, NEAR * max(left, 1.0)))


def _good(one: Judged) -> bool:
    """Return whether a correction explains an excess that is worth one."""
    return one.explains >= EXPLAINS and one.gain >= EXCESS - 1.0


def _same(a: Correction, b: Correction) -> bool:
    """Return whether corrections differ by their number alone."""
    return (a.kind, a.columns, a.runs) == (b.kind, b.columns, b.runs)


def _closest(shares: Mapping[Correction, float]) -> Iterator[list[Correction]]:
    """Yield the best corrections of the `CLOSEST` best groups of columns of each kind, the best first.

    Delays either way are two kinds: at constant speed what is early by a part of a turn is late by the rest.
    Of scales that a free gain makes up for, a unit comes first.
    """

    def order(c: Correction) -> tuple[float, bool, float]:
        return float(f"{shares[c]:.2g}"), not c.unit, shares[c]

    kinds: dict[tuple[str, bool], dict[tuple[str, ...], list[Correction]]] = {}
    for c in sorted((c for c in shares if shares[c] < 1), key=order):
        late = c.kind == "delay" and c.numbers[0] > 0
        kinds.setdefault((c.kind, late), {}).setdefault(c.columns, []).append(c)
    for groups in kinds.values():
        yield from islice(groups.values(), CLOSEST)


def _closer(model: Model, shares: Mapping[Correction, float]) -> list[Correction]:
    """Return the delays and means halfway to those beside the closest, and scales beside, not tried yet.

    `shares`: what was tried, and the share that it leaves of what was left.
    """
    out = []
    for c, *_ in _closest(shares):
        if shares[c] > (PART if c.kind in STEPS else 1 - NOTHING) or c.kind not in (*STEPS, "scale"):
            continue
        if c.kind == "scale":
            near = (WIDE[1] / WIDE[0]) * (1 + NOTHING)
            out += [o for o in _scaled(model, c.columns) if 1 / near < o.numbers[0] / c.numbers[0] < near]
            continue
        n, tried = c.numbers[0], [0.0, *(o.numbers[0] for o in shares if _same(o, c))]
        beside = max((k for k in tried if k < n), default=n), min((k for k in tried if k > n), default=n)
        between = (float(np.trunc((k + n) / 2)) for k in beside)
        out += [replace(c, numbers=(k,)) for k in between if k and (c.kind == "delay" or k > 1)]
    return [c for c in out if c not in shares]


NOTHING = 1e-6
"""Share by which a scale changes nothing: no reading follows that column."""
CLOSEST, NUMBERS = 4, 2
"""Groups of columns of each kind that are looked at more closely, and corrections of each that are tried."""
PART = 0.9
"""Share of what is left that a delay or a mean may leave to be looked at more closely."""


ALTERED = 2.0
"""Factor below which a scale that is none of a unit may be the machine's own: a reference's, a wavelength."""
REACH = 1.6
"""Logarithm of the factors that are tried about the best scale, either way."""
KNOWN, FAR = 0.01, 7
"""Part of a factor within which it must be known to be stated, and how often that is doubled at most."""


def _least(about: Correction, deviance: Callable[[Correction], float]) -> Correction:
    """Return the factor within `REACH` of one that has the least deviance."""

    def times(by: float) -> Correction:
        return replace(about, numbers=(about.numbers[0] * float(np.exp(by)),), unit="")

    def finite(by: float) -> float:
        value = deviance(times(by))
        return value if np.isfinite(value) else 1e9

    options = {"maxiter": 20, "xatol": 1e-5}
    search = scipy.optimize.minimize_scalar
    return times(float(search(finite, bounds=(-REACH, REACH), method="bounded", options=options).x))


def _in_runs(trials: Trials, base: Tried, odd: Sequence[int]) -> list[Found]:
    """Return the mistakes of runs that do not go with the others: of all together, else of each by itself.

    `base`: what the others agree on.
    """
    p, out = base.p, list[Found]()

    def look(runs: list[int]) -> Found | None:
        now = trials.at((), p, runs)
        if now is None or not now.left:
            return None
        tried = cache(lambda c: trials.at((_of(c, runs),), p, runs))
        screen = _screen(trials, now, runs, free=False)
        found = _best(trials, now, tried, screen, runs)
        after = found and trials.at((_of(found.correction, runs),), p, runs)
        if not found or not after:
            return None
        most = {r: 1 + (1 - EXPLAINS) * max(now.left[r] - 1, 0.0) for r in runs}
        good = [r for r in runs if after.left.get(r, 0.0) < most[r]]
        if not good:
            return None
        rivals = tuple(_of(c, good) for c in found.rivals)
        differs = _differs(trials, base, found.correction)
        return replace(found, correction=_of(found.correction, good), rivals=rivals, differs=differs)

    left, now = list(odd), trials.at((), p, odd)
    if now is None or not now.left:
        return []
    over = {r: now.counts[r] * max(now.left[r] - 1, 0.0) for r in now.left}
    may_stay = (1 - EXPLAINS) * sum(over.values())  # more than that, and no fit without them is explained
    while left and len(out) < DIFFERENT and (found := look(left)):
        out.append(found)
        left = [r for r in left if r not in found.correction.runs]
    if len(left) > 1 and len(out) < DIFFERENT:
        lost = 0.0
        for r in sorted(left, key=lambda r: over.get(r, 0.0), reverse=True):
            if found := look([r]):
                out.append(found)
            elif (lost := lost + over.get(r, 0.0)) > may_stay:
                break
    after = trials.at([one.correction for one in out], p, odd)
    stays = sum(now.counts[r] * max(n - 1, 0.0) for r, n in after.left.items()) if after else np.inf
    if not after or stays > may_stay or max(after.left.values(), default=np.inf) > ALONE:
        out = _other_device(trials, now, base, odd) or out
    return out


def _of(c: Correction, runs: Sequence[int]) -> Correction:
    """Return a correction of some runs; one that is of some already stays."""
    return c if c.runs else c.in_runs(runs)


def _other_device(trials: Trials, now: Tried, agreed: Tried, runs: Sequence[int]) -> list[Found]:
    """Return runs that parameters, and gains of readings, of their own describe, where no mistake does.

    As the other runs are `agreed` by theirs: so many parameters leave nothing but noise.
    """
    if agreed.mean(agreed.left) > EXCESS:
        return []
    floor = max(agreed.mean(agreed.left), 1.0)
    most = floor + _close(now, runs, floor)
    own = _with_gains(trials, now.p, runs)
    if own is None or not own.left or own.mean(own.left) >= most:
        return []
    after = own.mean(own.deviance), own.mean(own.left)
    one = Judged(now.mean(now.deviance), *after, Correction("other_device", runs=tuple(runs)))
    return [Found(one.correction, one.explains)]


FREE = (1e-4, 1e4)
"""Bounds of a gain: so wide that it is the gain that is fitted where a parameter can make up for it."""


def _with_gains(trials: Trials, p: np.ndarray, runs: Sequence[int]) -> Tried | None:
    """Return runs with the gains of readings, fitted with the parameters from `p` (n,), undone.

    Parameters that gains make up for stay at `p`, the values of the other runs.
    """
    model = trials.model
    names = {c: f"gain of {c}" for c in model.channels if c not in model.period}
    if not names:
        return trials.fitted((), runs)

    def step(s: Signals, known: Mapping[str, ca.SX]) -> None:
        s["reading"] *= ca.vertcat(*(known[names[c]] if c in names else 1 for c in model.channels))

    gains = tuple(Parameter(name, 1.0, *FREE, "1") for name in names.values())
    begin = model.with_parameters({name: {"nominal": value} for name, value in model.named(p).items()})
    begin = replace(begin, closed_form=None, guess=None)
    wide = begin.with_step("electronics", step, effect="gains of another device", parameters=gains)
    if (own := replace(trials, model=wide).fitted((), runs)) is None:
        return None
    values = wide.named(own.p)
    undone = [Correction("gain_step", (c,), (values[name],), tuple(runs)) for c, name in names.items()]
    return trials.at(undone, own.p[: len(p)], runs)


Residual = Callable[[Block], np.ndarray]


def _whitened(
    tried: Tried, runs: Sequence[int], *, centred: bool = True
) -> Iterator[tuple[Residual, np.ndarray, Block]]:
    """Yield runs with their residual over the noise: what computes it, and its values (K, samples).

    `centred`: less their means.
    """
    model = tried.model
    point = tried.cost.at(tried.p)
    rest = residuals(model, tried.p, dict(zip(tried.cost.summary.runs, point.offsets, strict=True)))
    sigma = np.array([tried.log.noise[c].value for c in model.channels])[:, None]
    columns = (*model.references, *model.state, *model.channels, "t_s")
    log = extended(tried.log, model, tried.log.noise.std, model.named(tried.p))
    for block in log.blocks(tuple(c for c in dict.fromkeys(columns) if c in log.columns)):
        if block.run in runs and len(block.data[model.channels[0]]) > 1:
            e = rest(block) / sigma
            yield (lambda b: rest(b) / sigma), e - centred * e.mean(axis=1, keepdims=True), block


def _inside(trials: Trials, tried: Tried, c: Correction, runs: Sequence[int]) -> float:
    """Return what readings at a rail leave, per reading that is kept: the model expects them beyond it.

    No less than noise counts. Of a reading that repeats no sample tells on which side it is.
    """
    model, (low, high), squares = trials.model, c.numbers, 0.0
    known = [k for k, n in enumerate(model.channels) if n in c.columns and n not in model.period]
    whole = replace(tried, log=trials.log((), runs))
    for _, e, block in _whitened(whole, runs, centred=False) if known else ():
        for k in known:
            x = block.data[model.channels[k]]
            back = np.where(x >= high, np.maximum(e[k], 0.0), np.where(x <= low, np.minimum(e[k], 0.0), 0.0))
            squares += float((back**2 - ((x <= low) | (x >= high))).sum())
    kept = sum(tried.counts.get(r, 0.0) for r in runs) * len(model.channels)
    return max(squares, 0.0) / max(kept, 1.0)


def _slope(rest: Residual, block: Block, column: str) -> np.ndarray:
    """Return the change of the residual with a column, (K, samples)."""
    x = block.data[column]
    h = 1e-3 * float(np.ptp(x)) or 1e-9
    slope = (rest(Block(block.run, {**block.data, column: x + h})) - rest(block)) / h
    return np.asarray(slope)


# -- mistakes of some samples ------------------------------------------------------------------------------

STILL = 8
"""Samples at either end of a run in which no step is looked for."""
STROKE = 0.1
"""Motion within a run over the range of all, below which a column is set from run to run."""
PILED = 3.0
"""Samples in the last hundredth of a column's range over those in the next, or at its last value over those
at the next, of a column that stops there: a sine has 2.4."""


def of_samples(trials: Trials, tried: Tried) -> Iterator[Correction]:
    """Yield the mistakes that begin or end within a run, where the columns or the residual show them."""
    runs = list(tried.left)
    yield from _turns(trials, runs)
    yield from _rails(trials, runs)
    yield from _repeated(trials, runs)
    yield from _coarse(trials, runs)
    if len(runs) == 1:
        yield from _steps(trials, tried, runs, within=True)
    if len(runs) < len(trials.spans):
        yield from _steps(trials, tried, runs, within=False)


SEARCHED = 6
"""Readings that are looked at one by one, at most."""


def _turns(trials: Trials, runs: Sequence[int]) -> Iterator[Correction]:
    """Yield readings that repeat with their range in some runs as a turn: an angle in volts, or in counts.

    Whole numbers of turns are tried as such.
    """
    some = np.isin(trials.run, list(runs))
    for c in (c for c in trials.model.channels if c in trials.model.period):
        turns = float(np.ptp(trials.full[c][some])) / trials.model.period[c]
        if turns > 0 and abs(round(turns) / turns - 1) > KNOWN:
            yield Correction("scale", (c,), (1 / turns,))


def _rails(trials: Trials, runs: Sequence[int]) -> Iterator[Correction]:
    """Yield columns that stop at a value in some runs: its ends hold more samples than the values beside."""
    some = np.isin(trials.run, list(runs))
    found: dict[str, tuple[float, float]] = {}
    for c in filter(is_moving, trials.columns):
        x = trials.full[c][some]
        strokes = [float(np.ptp(trials.full[c][at])) for run, at in trials.spans if run in runs]
        if not np.median(strokes) > STROKE * float(np.ptp(x)):  # at rest, or set from run to run
            continue
        ends = (_stop(x), -_stop(-x))
        for pair in {(ends[0], np.inf), (-np.inf, ends[1]), ends}:
            if np.isfinite(pair).any():
                found[c] = ends
                yield Correction("clipped", (c,), pair)
    if len(together := [c for c in found if c in trials.model.channels]) > 1:
        low, high = np.array([found[c] for c in together]).T
        yield Correction("clipped", tuple(together), (float(low.max()), float(high.min())))


def _stop(x: np.ndarray) -> float:
    """Return the least value that a column takes, or a hundredth of its range above, where it stops there.

    More samples are there than beside; -inf where they are not.
    """
    least, near = float(x.min()), float(np.ptp(x)) / 100
    there, beside = int(np.sum(x < least + near)), int(np.sum((x >= least + near) & (x < least + 2 * near)))
    if there > PILED * (beside + 2 * np.sqrt(beside + 1)):  # by more than chance
        return least + near
    same, following = int(np.sum(x == least)), int(np.sum(x == x[x > least].min()))
    return least if same > PILED * following else -np.inf


def _repeated(trials: Trials, runs: Sequence[int]) -> Iterator[Correction]:
    """Yield the columns that repeat samples in some runs; those that repeat the same ones together.

    A column without noise repeats values rightly: at rest, or where it goes one way twice.
    """
    found: dict[bytes, list[str]] = {}
    for c in filter(is_moving, trials.columns):
        if not any(is_noisy(trials.full[c][at]) for _, at in trials.spans):
            continue
        again = [repeats(trials.full[c][at]) for run, at in trials.spans if run in runs]
        if any(some.any() for some in again):
            found.setdefault(np.concatenate(again).tobytes(), []).append(c)
    yield from (Correction("stuck", tuple(together)) for together in found.values())


def _coarse(trials: Trials, runs: Sequence[int]) -> Iterator[Correction]:
    """Yield columns that come in steps which are larger than their noise."""
    some = np.isin(trials.run, list(runs))
    for c in filter(is_moving, trials.columns):
        values = np.unique(trials.full[c][some])
        step = _step_between(values) if len(values) < some.sum() else None  # of constant speed each is once
        if step is not None and step > trials.noise[c].value:
            yield Correction("coarse_steps", (c,), (step,))


def _steps(trials: Trials, tried: Tried, runs: Sequence[int], *, within: bool) -> Iterator[Correction]:
    """Yield, for each column, the step of its zero and of its gain that the residual of some runs shows best.

    `within`: from some sample of a run on, else all through the runs. The size is found by Gauss-Newton.
    """
    for c in (*trials.model.references, *trials.model.state, *tried.worst(runs)):
        if c not in trials.columns:
            continue
        for kind in ("zero_moved", "gain_step"):
            found = _step(trials, tried, c, kind, runs, within=within)
            if found is not None:
                yield found


def _step(
    trials: Trials, tried: Tried, column: str, kind: str, runs: Sequence[int], *, within: bool
) -> Correction | None:
    gain = kind == "gain_step"
    size, since = (1.0 if gain else 0.0), _place(tried, column, runs, gain=gain) if within else 0
    at: Tried | None = tried
    for _ in range(ROUNDS):
        change = _change(at, column, runs, since, gain=gain) if at else np.nan
        before, size = size, size / (1 - change) if gain else size + change
        if not np.isfinite(size) or not 0.05 < (abs(size) if gain else 1.0) < 20:
            return None
        now = Correction(kind, (column,), (size, float(since)) if within else (size,), tuple(runs))
        if abs(size - before) <= SETTLED * abs(size):
            break
        at = trials.at((now,), tried.p, runs)
    return now


def _parts(
    at: Tried, column: str, runs: Sequence[int], since: int, *, gain: bool
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield by run what a unit step of the zero (or gain) of a column adds, and the residual, less means."""
    for rest, e, block in _whitened(at, runs):
        x = block.data[column]
        part = _slope(rest, block, column) * (x if gain else 1.0) * (np.arange(len(x)) >= since)
        yield part - part.mean(axis=1, keepdims=True), e


def _change(at: Tried, column: str, runs: Sequence[int], since: int, *, gain: bool) -> float:
    """Return by how much the zero (or gain) of a column changes from a sample on, by least squares."""
    found = [
        ((part * e).sum(), (part * part).sum()) for part, e in _parts(at, column, runs, since, gain=gain)
    ]
    num, den = np.sum(found, axis=0) if found else (0.0, 0.0)
    return float(num / den) if den > 0 else np.nan


def _differs(trials: Trials, agreed: Tried, c: Correction) -> bool:
    """Return whether steps of each of the other runs explain what these leave: each has its own."""
    if c.kind not in ("zero_moved", "gain_step") or c.numbers[1:]:
        return False
    runs, over, explained = [*agreed.left], 0.0, 0.0
    whole = replace(agreed, log=trials.log((), runs))
    for part, e in _parts(whole, c.columns[0], runs, 0, gain=c.kind == "gain_step"):
        over += float((e * e).sum()) - EXCESS * e.size
        explained += float((part * e).sum()) ** 2 / max(float((part * part).sum()), 1e-300)
    return over > 0 and explained > EXPLAINS * over


def _place(at: Tried, column: str, runs: Sequence[int], *, gain: bool) -> int:
    """Return the sample of a run from which on a step of a column explains most of the residual; 0: none."""
    best, place = -1.0, 0
    for rest, e, block in _whitened(at, runs):
        x = block.data[column]
        if len(x) <= 2 * STILL:
            continue
        slope = _slope(rest, block, column) * (x if gain else 1.0)
        tail = slope[:, ::-1].cumsum(axis=1)[:, ::-1]
        explained = (slope * e)[:, ::-1].cumsum(axis=1)[:, ::-1].sum(axis=0)
        energy = (slope**2)[:, ::-1].cumsum(axis=1)[:, ::-1].sum(axis=0)
        energy = np.maximum(energy - (tail**2 / len(x)).sum(axis=0), 1e-12 * energy + 1e-300)  # of rounding
        power = explained**2 / energy
        k = int(np.argmax(power[STILL:-STILL])) + STILL
        if power[k] > best:
            best, place = float(power[k]), k
    return place
