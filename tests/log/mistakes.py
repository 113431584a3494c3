"""The table of mistakes that a lab makes: what each does to a log, what must be said, and how it ends.

A row is added where a mistake is learnt; `test_mistakes.py` makes each of them in every log it applies to.
`LOG` are those that a log reveals by itself and `test_log_check.py` does not make, `FIT` those that its model
reveals and `recordings.KINDS`, which draws the others by hundreds, does not make.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np
from twins import SIGMAS, six_runs

from hallsym.families import build, published
from hallsym.log import Log, Noise, Sigma
from hallsym.simulation import NoiseModel, paper_campaign, read_campaign, simulate

Arrays = dict[str, np.ndarray]
Make = Callable[[Arrays], Arrays | None]
"""Make the mistake in a copy of a log's arrays: in place, or return the arrays of another log."""

STAGE = ("57 runs", "6 runs")
ENCODER = ("encoder",)
ENCODER_SIGMA = {"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5}


Ends = Literal["refusal", "claim", "remark"]
"""Exit code 2; 3 with the sentence on stderr; 0 with a note on what harms nothing, or may be meant so.

A claim ends with 2 where nothing can be fitted.
"""


@dataclass(frozen=True)
class Mistake:
    """One mistake. `says`: a regular expression that one sentence must match; it names column, run, remedy.

    `found`: from the "log" alone, or by the "fit" of its
    model. `on`: the base logs in which it is made.
    """

    name: str
    make: Make
    says: str
    ends: Ends
    found: Literal["log", "fit"] = "log"
    on: tuple[str, ...] = STAGE


def base(name: str) -> tuple[Arrays, Noise]:
    """Return the arrays of a base log without a mistake, which may be changed, and its stated noise."""
    arrays, noise = _base(name)
    return {column: values.copy() for column, values in arrays.items()}, noise


def made(mistake: Mistake, name: str) -> Log:
    """Return a base log in which the mistake was made."""
    arrays, noise = base(name)
    changed = mistake.make(arrays)
    return Log.from_arrays(arrays if changed is None else changed, noise, name="bench.csv")


@cache
def _base(name: str) -> tuple[Arrays, Noise]:
    if name in ENCODER:
        folder = Path(__file__).resolve().parents[2] / "data" / "encoder"
        campaign, model, sigma = read_campaign(folder / "campaign.toml"), build("rotary"), ENCODER_SIGMA
        arrays = simulate(model, {"zero": 0.6}, campaign, NoiseModel(sigma), seed=1)
    else:
        campaign = paper_campaign() if name == "57 runs" else six_runs()
        model, sigma = build("stage31"), SIGMAS
        truth = published.values("table7_estimates")
        arrays = simulate(model, truth, campaign, NoiseModel(sigma), seed=1)
    return arrays, Noise({column: Sigma(value, "given") for column, value in sigma.items()})


# -- how they are made ---------------------------------------------------------------------------------------

READINGS = ("hall_a_m", "hall_b_m", "hall_c_m")
REFERENCES = ("x_ref_m", "y_ref_m", "rz_ref_rad")


def put(column: str, rows: object, value: object) -> Make:
    """Put a value into rows of a column."""

    def make(arrays: Arrays) -> None:
        arrays[column][rows] = value  # type: ignore[index]

    return make


def by(change: float | Callable[[np.ndarray], np.ndarray], *columns: str, run: int | None = None) -> Make:
    """Change columns by a factor or a function, in one run or in all."""

    def make(arrays: Arrays) -> None:
        at = slice(None) if run is None else arrays["run"] == run
        for column in columns:
            x = arrays[column][at]
            arrays[column][at] = change(x) if callable(change) else change * x

    return make


def exchanged(one: str, other: str) -> Make:
    """Exchange two columns."""
    return lambda arrays: {**arrays, one: arrays[other], other: arrays[one]}


def keep(rows: Callable[[Arrays], np.ndarray]) -> Make:
    """Keep the rows that a function chooses, by a mask or in an order."""
    return lambda arrays: {name: values[rows(arrays)] for name, values in arrays.items()}


def rails(columns: tuple[str, ...], share: float, noise: float) -> Make:
    """Cut readings off so that a share of the samples lies on the rails; `noise` is added behind them."""

    def make(arrays: Arrays) -> Arrays:
        for name in columns:
            x = arrays[name]
            low, high = np.quantile(x, [share / 2, 1 - share / 2])
            arrays[name] = np.clip(x, low, high) + noise * np.random.default_rng(0).standard_normal(len(x))
        return arrays

    return make


def of_run(run: int, start: int | None = None, stop: int | None = None) -> Callable[[Arrays], slice]:
    """Return rows of one run: from its sample `start` to `stop`, counted as a slice counts."""

    def rows(arrays: Arrays) -> slice:
        here = np.flatnonzero(arrays["run"] == run)[start:stop]
        return slice(int(here[0]), int(here[-1]) + 1)

    return rows


def hold(columns: tuple[str, ...], where: Callable[[Arrays], slice], value: float | None = None) -> Make:
    """Repeat the first value of a stretch, or another value, through it."""

    def make(arrays: Arrays) -> None:
        rows = where(arrays)
        for name in columns:
            arrays[name][rows] = arrays[name][rows.start] if value is None else value

    return make


def pasted(columns: tuple[str, ...], source: int, to: int) -> Make:
    """Put columns of one run in the place of another run's."""

    def make(arrays: Arrays) -> None:
        for name in columns:
            arrays[name][of_run(to)(arrays)] = arrays[name][of_run(source)(arrays)]

    return make


def appended(arrays: Arrays) -> Arrays:
    """Append a log to itself, at a later time, under other numbers."""
    again = {
        **arrays,
        "t_s": arrays["t_s"] + arrays["t_s"][-1] + 1.0,
        "run": arrays["run"] + arrays["run"].max() + 1,
    }
    return {name: np.concatenate([arrays[name], again[name]]) for name in arrays}


def one_number_for(first: int, second: int) -> Make:
    """Give two runs one number, each of them with a clock that begins at 0."""

    def make(arrays: Arrays) -> None:
        for run in np.unique(arrays["run"]).tolist():
            arrays["t_s"][of_run(run)(arrays)] -= arrays["t_s"][of_run(run)(arrays).start]
        arrays["run"][arrays["run"] == second] = first

    return make


def slower(column: str, times: int, *, lines: bool = False) -> Make:
    """Record a column at a lower rate than the others; `lines`: interpolated between its samples."""

    def make(arrays: Arrays) -> Arrays:
        x = arrays[column]
        at = np.arange(len(x)) / times
        return {**arrays, column: np.interp(at if lines else np.floor(at), at[::times], x[::times])}

    return make


def traded(columns: tuple[str, ...], one: int, other: int) -> Make:
    """Give each of two runs of one length columns of the other."""

    def make(arrays: Arrays) -> Arrays:
        a, b = (of_run(run)(arrays) for run in (one, other))
        out = {**arrays, **{c: arrays[c].copy() for c in columns}}
        for c in columns:
            out[c][a], out[c][b] = arrays[c][b], arrays[c][a]
        return out

    return make


def of(on: tuple[str, ...], found: Literal["log", "fit"], ends: Ends, rows: Mapping[str, tuple[Make, str]]):
    prefix = "encoder: " if on == ENCODER else ""
    return tuple(Mistake(prefix + name, make, says, ends, found, on) for name, (make, says) in rows.items())


def undone_by(text: str) -> str:
    """Return what must be said: the option that undoes the mistake."""
    return rf"undo it with --correct '{text}'"


_TURN, _PLATES, _DEGREE = 2 * np.pi, ("v_sin_v", "v_cos_v"), 180 / np.pi
_UNIT = undone_by("scale angle_ref_rad {}")
_RAILS = r"undo it with --correct 'clipped hall_a_m -"
_REVERSED = r"turns against angle_ref_rad .*; v_sin_v is taken with its sign reversed"

LOG = (
    *of(STAGE, "log", "refusal", {
        "a column of NaN": (put("hall_b_m", slice(None), np.nan), r"hall_b_m .*no finite.*record"),
        "two recordings under one number": (
            one_number_for(1, 2),
            r"t_s .* runs backwards 1 times, first in row 1001 \(run 1\).*number the runs"),
        "a sample written twice": (keep(lambda a: np.sort(np.r_[np.arange(len(a["run"])), 1700])),
                                   r"t_s .* repeats 1 times, first in row 1702 \(run 3\).*sort"),
    }),
    *of(STAGE, "log", "remark", {
        "time in ms": (by(1e3, "t_s"), r"usual step of 2 s; if that is 2 ms, say --column t_ms=t_s"),
        "runs of 10 samples": (
            keep(lambda a: np.concatenate([np.flatnonzero(a["run"] == k)[::50] for k in range(57)])),
            r"usual run .* has 10 samples: "),
    }),
    *of(STAGE, "log", "claim", {
        "time in ms, said to be us": (by(1e-6, "t_s"), r"In run \d .* covers .*units of .* and t_s"),
        "a channel logged twice": (lambda a: {**a, "hall_b_m": a["hall_a_m"]},
                                   r"hall_a_m and hall_b_m .* logged twice"),
        "a reference frozen to the end of a run": (hold(("y_ref_m",), of_run(2, -100)),
                                                   r"y_ref_m .* 100 .* run 2,.*old"),
        "a channel that drops out": (hold(("hall_c_m",), of_run(2, 200, 300), 0.0),
                                     r"hall_c_m .* run 2, 0 m.*dropped"),
        "a reading frozen for a fifth of the log": (
            hold(("hall_a_m",), lambda a: slice(600, 600 + len(a["run"]) // 5)),
            r"hall_a_m .* (holds one value|never changes)"),
        "a log appended to itself": (appended,
                                     r"the same samples in runs 0 and \d+ \(and \d+ more pairs\): remove"),
        "another run's reference": (pasted(REFERENCES, 1, 4), r"x_ref_m, y_ref_m, rz_ref_rad .* 1 and 4"),
    }),
    *of(ENCODER, "log", "claim", {
        "a plate dead in a run": (hold(("v_cos_v",), of_run(2), 0.0), r"v_cos_v .* run 2, 0 V.*dropped"),
        "a reference frozen to the end": (hold(("angle_ref_rad",), of_run(2, -60)),
                                          r"angle_ref_rad .* 60 .* run 2,"),
    }),
)  # fmt: skip
FIT = (
    *of(STAGE, "fit", "claim", {
        "20 % on the rails, with noise": (rails(("hall_a_m",), 0.2, noise=5e-7), _RAILS),
        "8 % on the rails, with noise": (rails(("hall_a_m",), 0.08, noise=5e-7), _RAILS),
        "a reference at a tenth of the rate": (slower("x_ref_m", 10),
                                               r"x_ref_m .* about 10 times.* record all columns at one rate"),
        "an interpolated reference": (slower("x_ref_m", 10, lines=True),
                                      r"x_ref_m .* lines of about 10 samples.* record all columns"),
        "y inverted": (by(-1, "y_ref_m"), undone_by("sign y_ref_m")),
        "all readings inverted": (by(-1, *READINGS), r"'sign x_ref_m,.*' would do as well; "
                                  + undone_by("sign hall_a_m,hall_b_m,hall_c_m")),
    }),
    *of(ENCODER, "fit", "claim", {
        "20 % on the rails, with noise": (rails(_PLATES, 0.2, noise=3.5e-4), r"'clipped v_sin_v,v_cos_v "),
        "degrees for rad": (by(_DEGREE, "angle_ref_rad"), _UNIT.format("deg")),
        "turns for rad": (by(1 / _TURN, "angle_ref_rad"), _UNIT.format("rev")),
        "gradians for rad": (by(400 / _TURN, "angle_ref_rad"), _UNIT.format("grad")),
        "counts of another resolution": (by(lambda a: a % _TURN / 4, "angle_ref_rad"), _UNIT.format("4")),
        "references of two runs": (traded(("angle_ref_rad",), 1, 3), r"all runs but 1,3, .* --holdout 1,3"),
        "a reference that stands in one run": (by(0, "angle_ref_rad", run=1),
                                               r"--correct 'clipped angle_ref_rad .* inf"),
    }),
    *of(ENCODER, "fit", "remark", {
        "an inverted plate": (by(-1, "v_cos_v"), _REVERSED),
        "exchanged plates": (exchanged(*_PLATES), _REVERSED),
    }),
)  # fmt: skip
