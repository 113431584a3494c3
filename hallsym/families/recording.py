"""Mistakes of a recording, the first link of the chain: what each does to the samples, and its remedy.

A mistake is stated by a text, which a fit proposes, `--correct` takes and a calibration saves:

    sign x_ref_m                        the other sign
    scale rx_rad deg                    the numbers are in another unit, or times a factor
    exchange z_m rx_rad                 each holds the other's values
    delay hall_a_m 3                    late by so many samples (early where negative)
    zero_moved x_ref_m 2e-5 from 400    its zero lies so much higher, from a sample on
    gain_step hall_a_m 1.05             its gain is so many times what it is elsewhere
    clipped x_ref_m -3e-4 3e-4          it stops at these values
    stuck hall_b_m 120 180              it stands still from one sample to before another
    averaged hall_a_m,hall_b_m 3        it holds centred means over so many samples
    coarse_steps hall_a_m 1e-5          it is rounded to steps
    copied_run in 7                     the run is a copy of another
    other_device in 20-40               the runs are of another device

Each may end with runs, `in 3,5,7-9`; without, all runs have it. Samples are counted from 0 in their run.
Without samples, `stuck` finds them: a noisy column stands still there, or repeats earlier samples.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np

from hallsym.errors import InputError, counted, listed, nearest
from hallsym.log import Log, Noise
from hallsym.log.columns import RUN, read_runs, run_list
from hallsym.log.core import Block
from hallsym.log.phase import continuous
from hallsym.log.quality.scan import STUCK_SAMPLES
from hallsym.log.table import CHUNK_ROWS, Piece, TableLike, View, joined
from hallsym.model import Model
from hallsym.units import UNITS, split_unit

Data = dict[str, np.ndarray]
"""Columns of one run, each (samples,)."""
Sources = dict[str, tuple[str, float]]
"""By column: the one that holds its values, and the factor to multiply these by."""


@dataclass(frozen=True)
class Correction:
    """What undoes a mistake: `kind` of mistake, its `columns` and numbers, and its `runs`, all where empty.

    `unit`: that a column's numbers are in, of a wrong scale; its first number is then the factor to SI.
    """

    kind: str
    columns: tuple[str, ...] = ()
    numbers: tuple[float, ...] = ()
    runs: tuple[int, ...] = ()
    unit: str = ""

    @property
    def mistake(self) -> "Mistake":
        """What is known of such mistakes."""
        return MISTAKES[self.kind]

    @property
    def text(self) -> str:
        """What `--correct` takes.

        >>> Correction("delay", ("hall_a_m",), (3,), (4, 5, 6, 9)).text
        'delay hall_a_m 3 in 4-6,9'
        """
        known = self.mistake
        columns = self.columns if known.pair else (",".join(self.columns),) if self.columns else ()
        numbers = [self.unit] if self.unit else [f"{n:.9g}" for n in self.numbers]
        if known.since and self.numbers:
            numbers = [*numbers[:1], *(("from", numbers[1]) if self.numbers[1:] else ())]
        runs = ["in", run_list(self.runs)] if self.runs else []
        return " ".join([self.kind, *columns, *numbers, *runs])

    def in_runs(self, runs: Sequence[int]) -> "Correction":
        """Return the same of some runs."""
        return replace(self, runs=tuple(runs))

    def noise_of(self, noise: Noise, runs: Sequence[int] | None = None) -> Noise:
        """Return the noise of the columns when it is undone, in some runs of a log or in all.

        What is estimated of a log is that of the runs without the mistake where it has some; of runs with it
        and others the larger noise counts.
        """
        if not self.runs:
            return self.mistake.noise(self, noise)
        stated = Noise({n: replace(s, source="given") for n, s in noise.sigmas.items()})
        after = self.mistake.noise(self, stated).sigmas
        every = runs is not None and {*runs} <= {*self.runs}
        larger = {
            n: s if every else max(s, stated.sigmas[n], key=lambda s: s.value) for n, s in after.items()
        }
        return Noise({n: replace(s, source=noise.sigmas[n].source) for n, s in larger.items()})

    def undo(self, data: Data, run: int) -> np.ndarray | None:
        """Undo the mistake in the columns of one run, in place; return which samples stay, None for all."""
        return None if self.runs and run not in self.runs else self.mistake.undo(self, data)


@dataclass(frozen=True, eq=False)
class Mistake:
    """A kind of mistake: what it means, how it is undone in the columns of a run, and what its text holds.

    `numbers`: names of the numbers after the columns; `since`: the second is a sample, after "from", and may
    be absent. `seen`: all may be, as the columns show them. `pair`: the text names two columns. `whole_run`:
    the text names runs in place of columns. `keeps`: no value changes, the noise alone does.
    `cuts`: its columns tell which samples are left out. `factor`: what undoing it multiplies columns by.
    `sources`: where the right values stand, of a mistake that each sample is put right by alone, by a factor.
    """

    name: str
    meaning: str
    undo: Callable[[Correction, Data], np.ndarray | None]
    numbers: tuple[str, ...] = ()
    since: bool = False
    seen: bool = False
    pair: bool = False
    whole_run: bool = False
    noise: Callable[[Correction, Noise], Noise] = lambda c, noise: noise
    keeps: bool = False
    cuts: bool = False
    factor: Callable[[Correction], float] = lambda c: 1.0
    sources: Callable[[Correction], Sources] = lambda c: {}


def _from_sources(c: Correction, data: Data) -> None:
    data |= {name: factor * data[source] for name, (source, factor) in c.mistake.sources(c).items()}


def _earlier(c: Correction, data: Data) -> np.ndarray:
    late, n = round(c.numbers[0]), len(next(iter(data.values())))
    for name in c.columns:
        data[name] = np.roll(data[name], -late)
    at = np.arange(n)
    return np.asarray(at < n - late if late > 0 else at >= -late)


def _after(c: Correction, data: Data, name: str) -> np.ndarray:
    return np.asarray(np.arange(len(data[name])) >= (c.numbers[1] if c.numbers[1:] else 0))


def _shift_back(c: Correction, data: Data) -> None:
    for name in c.columns:
        data[name] = data[name] - c.numbers[0] * _after(c, data, name)


def _gain_back(c: Correction, data: Data) -> None:
    for name in c.columns:
        data[name] = np.where(_after(c, data, name), data[name] / c.numbers[0], data[name])


PRINTED = 1e-8
"""Part of a rail by which it may be off as a text gives it, in nine digits."""


def _off_rails(c: Correction, data: Data) -> np.ndarray:
    low, high = (
        n * (1 + PRINTED * np.sign(n) * inwards) for n, inwards in zip(c.numbers, (1, -1), strict=True)
    )
    return np.all([(data[name] > low) & (data[name] < high) for name in c.columns], axis=0)


HASH = np.uint64(0x9E3779B97F4A7C15)
"""Multiplier of a hash of values in 64 bits: 2^64 over the golden ratio (Knuth, TAOCP 3, 6.4)."""


def repeats(x: np.ndarray) -> np.ndarray:
    """Return which samples of a run (n,) are among `STUCK_SAMPLES` values that it had before: (n,)."""
    if len(x) <= STUCK_SAMPLES:
        return np.zeros(len(x), dtype=bool)
    code = np.unique(x, return_inverse=True)[1].astype(np.uint64)
    key = np.zeros(len(x) - STUCK_SAMPLES + 1, dtype=np.uint64)  # of each stretch: two share one by 2^-64
    for k in range(STUCK_SAMPLES):
        key = key * HASH + code[k : len(key) + k]
    _, first, same = np.unique(key, return_index=True, return_inverse=True)
    again = first[same] < np.arange(len(key))
    return np.asarray(np.convolve(again, np.ones(STUCK_SAMPLES)) > 0.5)


def _without(c: Correction, data: Data) -> np.ndarray:
    if not c.numbers:
        return ~np.any([repeats(data[name]) for name in c.columns], axis=0)
    at = np.arange(len(data[c.columns[0]]))
    return np.asarray((at < c.numbers[0]) | (at >= c.numbers[1]))


def _mean(samples: int) -> np.ndarray:
    """Return the weights of a centred mean; of an even number of samples the outermost count half."""
    weights = np.ones(2 * (samples // 2) + 1)
    weights[[0, -1]] -= 0.5 * (samples % 2 == 0)
    return weights / samples


SMOOTH = 2.0
"""Phase [rad] that the fastest part of a motion advances within a mean that can be undone: half the wave."""


@lru_cache(maxsize=64)
def _sharpening(samples: int) -> np.ndarray:
    """Return the weights that undo a centred mean of what is smooth over it, to 1.3e-3 (of 2) or 5e-4.

    1 + r_1 u + r_2 u^2, u the negative second difference over half a mean, which has the response
    2 - 2 cos(h w); r by least squares of its product with the response of the mean over the band.
    """
    half, mean = max(samples // 2, 1), _mean(samples)
    w = np.linspace(0.0, SMOOTH / samples, 200)
    response = mean @ np.cos(np.outer(np.arange(len(mean)) - len(mean) // 2, w))
    u = 2 - 2 * np.cos(half * w)
    r, *_ = np.linalg.lstsq(np.stack([response * u, response * u**2], axis=1), 1 - response, rcond=None)
    second = np.zeros(2 * half + 1)
    second[[0, half, -1]] = -1.0, 2.0, -1.0
    weights = r[1] * np.convolve(second, second)
    weights[half:-half] += r[0] * second
    weights[2 * half] += 1.0
    return weights


def _sharpen(c: Correction, data: Data) -> np.ndarray:
    weights, n = _sharpening(round(c.numbers[0])), len(next(iter(data.values())))
    out = len(weights) // 2 + round(c.numbers[0]) // 2
    for name in c.columns if n > 2 * out else ():
        data[name] = np.convolve(data[name], weights, "same")
    at = np.arange(n)
    return np.asarray((at >= out) & (at < n - out))


def _kept(c: Correction, data: Data) -> None:
    return None


def _left_out(c: Correction, data: Data) -> np.ndarray:
    return np.zeros(len(next(iter(data.values()))), dtype=bool)


def _noise_of_sources(c: Correction, noise: Noise) -> Noise:
    """An estimated noise is that of the numbers; a stated one is meant in SI."""
    moved = {
        n: s if s.source == "given" else replace(s, value=abs(factor) * s.value)
        for n, (source, factor) in c.mistake.sources(c).items()
        if (s := noise.sigmas.get(source)) is not None
    }
    return Noise({**{n: s for n, s in noise.sigmas.items() if n not in c.columns}, **moved})


def _rounding_noise(c: Correction, noise: Noise) -> Noise:
    step = c.numbers[0] / math.sqrt(12)
    coarse = {
        n: replace(s, value=math.hypot(s.value, step)) for n, s in noise.sigmas.items() if n in c.columns
    }
    return Noise({**noise.sigmas, **coarse})


def _sharpened_noise(c: Correction, noise: Noise) -> Noise:
    """Return the noise after the mean and its undoing; differences of neighbours show the mean's by 1/n."""
    many = round(c.numbers[0])
    factor = float(np.linalg.norm(np.convolve(_mean(many), _sharpening(many))))
    sharp = {
        n: replace(s, value=s.value * factor * (1 if s.source == "given" else many))
        for n, s in noise.sigmas.items()
        if n in c.columns
    }
    return Noise({**noise.sigmas, **sharp})


MISTAKES = {
    m.name: m
    for m in (
        Mistake(
            "sign", "the sign of {columns} is inverted", _from_sources,
            sources=lambda c: {name: (name, -1.0) for name in c.columns},
        ),
        Mistake(
            "scale", "the numbers of {columns} are {scale}", _from_sources, ("UNIT or FACTOR",),
            noise=_noise_of_sources, factor=lambda c: c.numbers[0],
            sources=lambda c: {name: (name, c.numbers[0]) for name in c.columns},
        ),
        Mistake(
            "exchange", "columns {columns} are exchanged", _from_sources, pair=True,
            noise=_noise_of_sources,
            sources=lambda c: {a: (b, 1.0) for a, b in (c.columns, c.columns[::-1])},
        ),
        Mistake("delay", "the values of {columns} come {delay}", _earlier, ("SAMPLES",), cuts=True),
        Mistake(
            "zero_moved", "the zero of {columns} moves by {0:.4g}{since}", _shift_back, ("VALUE", "SAMPLE"),
            since=True,
        ),
        Mistake(
            "gain_step", "the gain of {columns} is {0:.4g} times what it is elsewhere{since}", _gain_back,
            ("FACTOR", "SAMPLE"), since=True, factor=lambda c: 1 / c.numbers[0],
        ),
        Mistake("clipped", "the values of {columns} stop at {rails}", _off_rails, ("LOW", "HIGH"), cuts=True),
        Mistake(
            "stuck", "the values of {columns} stand still{stretch}", _without, ("START", "STOP"), seen=True,
            cuts=True,
        ),
        Mistake(
            "averaged", "the values of {columns} are means over {0:.0f} samples", _sharpen,
            ("SAMPLES",), noise=_sharpened_noise, cuts=True,
        ),
        Mistake(
            "coarse_steps", "the values of {columns} come in steps of {0:.4g}", _kept, ("STEP",),
            noise=_rounding_noise, keeps=True,
        ),
        Mistake("copied_run", "the samples are those of another run", _left_out, whole_run=True),
        Mistake("other_device", "the samples are of another device", _left_out, whole_run=True),
    )
}  # fmt: skip
"""By name; of the chain they come first, before the clock."""


FACTORS = (10.0, 1e2, 1e3, 1e4, 1e5, 1e6)
"""Wrong scales that are tried beside those of units, with their inverses: a decimal point, a conversion that
was done twice; between them lie counts."""
RATIOS = tuple(range(2, 13))
"""Turns of one column in a turn of another: pole pairs, gears, counts of another resolution."""


def scales(model: Model, columns: Sequence[str]) -> list[tuple[str, float]]:
    """Return the units that numbers of columns may be in, and plain factors, each with the factor to SI."""
    own = {split_unit(c)[1] for c in columns}
    if len(own) != 1 or (unit := own.pop()) is None:
        return []
    named = {u.factor: u.name for u in UNITS.values() if u.si == unit.si and not u.offset and u.factor > 1e-7}
    factors = dict.fromkeys([*named, *(1 / f for f in named), *FACTORS, *(1 / f for f in FACTORS)])
    if any(c in model.period for c in columns):
        factors |= dict.fromkeys([*RATIOS, *(1 / n for n in RATIOS)])
    return [(named.get(f, ""), f) for f in factors if f != 1.0]


def said(c: Correction) -> str:
    """Return a mistake in words.

    >>> said(Correction("scale", ("rx_rad",), (0.017453,), (3,), "deg"))
    'the numbers of rx_rad are in deg in run 3'
    """
    late = c.numbers[0] if c.kind == "delay" else 0.0
    ends = [f"{n:.0f}" for n in c.numbers[:2]]
    factor = abs(c.numbers[0]) if c.kind == "scale" else 1.0  # other numbers may be 0
    off = f"{factor:.4g} times too small" if factor > 1 else f"{1 / factor:.4g} times too large"
    words = {
        "columns": listed(c.columns) if 0 < len(c.columns) < 4 else f"{', '.join(c.columns[:2])} and so on",
        "rails": " and ".join(f"{n:.5g}" for n in c.numbers if math.isfinite(n)),
        "scale": f"in {c.unit}" if c.unit else off,
        "delay": f"{counted(abs(round(late)), 'sample')} {'late' if late > 0 else 'early'}",
        "since": f" from sample {c.numbers[1]:.0f} on" if c.numbers[1:] else "",
        "stretch": f" from sample {' to '.join(ends)}" if ends else " or repeat earlier ones",
    }
    text = c.mistake.meaning.format(*c.numbers, **words)
    return f"{text} in {_runs(c.runs)}" if c.runs else text


def _runs(runs: Sequence[int]) -> str:
    return f"run {runs[0]}" if len(runs) == 1 else f"runs {run_list(runs)}"


def read_correction(text: str) -> Correction:
    """Return the correction that a text states. Raises `InputError` for another form.

    >>> read_correction("delay hall_a_m,hall_b_m -2 in 3-5")
    Correction(kind='delay', columns=('hall_a_m', 'hall_b_m'), numbers=(-2.0,), runs=(3, 4, 5), unit='')
    """
    words = text.split()
    runs: tuple[int, ...] = ()
    if "in" in words[1:-1]:
        at = len(words) - 1 - words[::-1].index("in")
        if at == len(words) - 2 and words[-1] not in UNITS:
            runs, words = read_runs(words[-1], f"Runs of correction {text!r}"), words[:at]
    if not words or words[0] not in MISTAKES:
        raise InputError(
            f"Correction {text!r} must begin with one of {', '.join(MISTAKES)}"
            f"{nearest(words[0] if words else '', list(MISTAKES))}."
        )
    known, rest = MISTAKES[words[0]], [w for w in words[1:] if w != "from"]
    count = 0 if known.whole_run else 2 if known.pair else 1
    columns = rest[:2] if known.pair else rest[:1][0].split(",") if count and rest else []
    most, given = len(known.numbers), rest[count:]
    many = len(given) in (most, most - known.since, 0 if known.seen else most)
    if len(rest) < count or not many or (known.whole_run and not runs):
        raise InputError(f"Correction {text!r} must read {usage(known)!r}.")
    unit, numbers = "", []
    for word in given:
        if known.name == "scale" and word in UNITS:
            unit, numbers = word, [_factor(columns, word, text)]
        else:
            numbers.append(_number(word, text, known))
    return Correction(known.name, tuple(columns), tuple(numbers), runs, unit)


def usage(known: Mistake) -> str:
    """Return the form of a text."""
    what = ["in RUNS"] if known.whole_run else ["COLUMN", "COLUMN"] if known.pair else ["COLUMN[,COLUMN]"]
    numbers = [known.numbers[0], "[from SAMPLE]"] if known.since else list(known.numbers)
    numbers = [f"[{' '.join(numbers)}]"] if known.seen else numbers
    return " ".join([known.name, *what, *numbers, *([] if known.whole_run else ["[in RUNS]"])])


def _number(word: str, text: str, known: Mistake) -> float:
    try:
        value = float(word)
    except ValueError:
        value = math.nan
    whole = "SAMPLES" in known.numbers or known.name == "stuck"
    bad = math.isnan(value) or (known.name in ("scale", "gain_step") and not 0 < abs(value) < math.inf)
    if bad or (whole and not value.is_integer()):
        raise InputError(f"Correction {text!r} must read {usage(known)!r}; {word!r} is no such number.")
    return value


def _factor(columns: Sequence[str], unit: str, text: str) -> float:
    """Return the factor from a unit to that of the columns, which is SI."""
    si = {own.si if (own := split_unit(c)[1]) else "" for c in columns}
    if si != {UNITS[unit].si}:
        raise InputError(f"Correction {text!r} must name a unit of {', '.join(columns)}; {unit} is none.")
    return UNITS[unit].factor


class Corrected(View):
    """A table without the mistakes that corrections undo; whole runs are read at once."""

    def __init__(self, table: TableLike, corrections: Sequence[Correction]) -> None:
        """Undo `corrections`; the attribute of this name holds those of the table too."""
        super().__init__(table)
        self.own = tuple(corrections)
        self.corrections: tuple[Correction, ...] = (*getattr(table, "corrections", ()), *self.own)
        self._held: Piece = {}

    def count(self) -> int:
        """Return the number of rows that are kept."""
        return self._rows

    @cached_property
    def _rows(self) -> int:
        return sum(len(piece[RUN]) for piece in self.pieces((RUN,), CHUNK_ROWS))

    def counts_per_turn(self, column: str) -> float | None:
        """Return the counts of a turn of a column; None of one whose values are changed."""
        changed = any(column in c.columns for c in self.own)
        return None if changed else self.table.counts_per_turn(column)

    def pieces(self, columns: Sequence[str], size: int) -> Iterator[Piece]:
        """Yield the corrected rows, as `Table.pieces` does; a table in memory is corrected once."""
        if not self.in_memory:
            yield from self._pieces(columns, size)
            return
        new = [name for name in columns if name not in self._held]
        if new:
            parts = list(self._pieces(new, CHUNK_ROWS))
            self._held |= joined(parts, new) if parts else {name: np.empty(0) for name in new}
        yield {name: self._held[name] for name in columns}

    def _pieces(self, columns: Sequence[str], size: int) -> Iterator[Piece]:
        """Yield runs, several at a time where they are short."""
        partners = [c for one in self.own if set(one.columns) & {*columns} or one.mistake.cuts
                    for c in one.columns]  # fmt: skip
        asked = tuple(c for c in dict.fromkeys((*columns, *partners)) if c != RUN)
        waiting: list[Piece] = []
        for block in Log(self.table).blocks(asked or self.table.columns[1:2], size=2**62):
            data, keep = corrected_run(block, self.own)
            rows = len(next(iter(data.values())))
            data[RUN] = np.full(rows, block.run, dtype=np.int64)
            kept = {c: data[c] if keep is None else data[c][keep] for c in columns}
            if keep is None or keep.any():
                waiting.append(kept)
            if sum(len(next(iter(p.values()))) for p in waiting) >= size:
                yield joined(waiting, columns)
                waiting = []
        if waiting:
            yield joined(waiting, columns)


def corrected_run(block: Block, corrections: Sequence[Correction]) -> tuple[Data, np.ndarray | None]:
    """Return the columns of one whole run without its mistakes, and which samples stay (None: all)."""
    data, keep = dict(block.data), None
    for one in corrections:
        if not all(c in data for c in one.columns):
            continue
        stays = one.undo(data, block.run)
        if stays is not None:
            keep = stays if keep is None else keep & stays
    return data, keep


Assignment = tuple[tuple[str, int], ...]
"""For each channel of a model: the column that carries it, and its sign."""


def assignment_of(corrections: Sequence[Correction], channels: Sequence[str]) -> Assignment | None:
    """Return how channels are wired for corrections of whole logs; None where they are as named."""
    found = {c: (c, 1) for c in channels}
    for one in corrections:
        if one.runs or not set(one.columns) <= set(channels):
            continue
        if one.kind == "sign":
            found |= {c: (found[c][0], -found[c][1]) for c in one.columns}
        elif one.kind == "exchange":
            a, b = one.columns
            found[a], found[b] = found[b], found[a]
    return None if all(found[c] == (c, 1) for c in channels) else tuple(found.values())


def as_corrections(assignment: Assignment, channels: Sequence[str]) -> tuple[Correction, ...]:
    """Return the corrections that an assignment is, for which `assignment_of` returns it."""
    out, now = [], list(channels)
    for k, (source, _) in enumerate(assignment):
        if now[k] != source:
            other = now.index(source)
            out.append(Correction("exchange", (channels[k], channels[other])))
            now[k], now[other] = now[other], now[k]
    inverted = tuple(c for c, (_, sign) in zip(channels, assignment, strict=True) if sign < 0)
    return (*out, *([Correction("sign", inverted)] if inverted else []))


def as_read(log: Log, model: Model, corrections: Sequence[Correction] = ()) -> Log:
    """Return the log as `model` reads it: without its mistakes, columns that repeat made continuous."""
    return continuous(corrected(log, corrections), model)


def corrected(log: Log, corrections: str | Sequence[Correction | str]) -> Log:
    """Return the log without the mistakes that corrections undo; the log itself where there are none.

    `corrections`: as they are, or as their texts, of which one alone needs no list. A correction that the log
    has already, as the log of a fit has, is not made twice.
    Raises `InputError` for a column or a run that the log does not have.
    """
    known, given = getattr(log.table, "corrections", ()), corrections
    texts = [given] if isinstance(given, str) else given
    every = [read_correction(one) if isinstance(one, str) else one for one in texts]
    undone = [one for one in every if one not in known]
    if not undone:
        return log
    for one in undone:
        log.table.require(one.columns)
        if unknown := set(one.runs) - set(log.runs):
            raise InputError(
                f"Correction '{one.text}' names run {min(unknown)}, which {log.name} does not have."
            )
    noise = log.noise
    for one in undone:
        noise = noise if one.runs else one.mistake.noise(one, noise)
    return replace(log, table=Corrected(log.table, undone), noise=noise)
