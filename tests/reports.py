"""Reports on what data determine, of which tests draw pictures, and what holds for every picture."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from twins import SIGMAS, TRUTH, record, with_noise

from hallsym.estimation import fit
from hallsym.families import build
from hallsym.inference import Identifiability, Interval, Side, Verdict, identify
from hallsym.report.data.gather import RunSeries, series_of
from hallsym.report.data.survey import Trace
from hallsym.report.figures.style import WIDTH
from hallsym.simulation import Campaign, NoiseModel, Run, simulate, sine


@cache
def full() -> Identifiability:
    """The paper's campaign: three structural pairs, everything else determined."""
    return identify(fit(with_noise(record(seed=1)), "stage31", solver="direct", loss="none"), profiles="all")


def constant_height() -> Campaign:
    motion = {"x_m": sine(3e-4, 1.0), "y_m": sine(5e-4, 1.5), "rz_rad": sine(3e-4, 2.5)}
    return Campaign(0.01, (Run(2.0, {}, motion, (0.0, 0.0, 0.0)),))


@cache
def level() -> Identifiability:
    """One run at one height: nothing of a, b, c."""
    values = {n: v for n, v in TRUTH.items() if n[0] not in "abc"}
    columns = simulate(build("stage31"), values, constant_height(), NoiseModel(SIGMAS), seed=1)
    return identify(fit(with_noise(columns), "stage31", solver="direct"), profiles="none")


@cache
def plan() -> Identifiability:
    """A campaign that nobody has recorded yet."""
    return identify(build("stage31"), constant_height(), values=TRUTH, noise=SIGMAS, name="level.toml")


@cache
def odd() -> Identifiability:
    """The full report with every verdict and every end an interval can have."""
    whole = full()
    changes: dict[str, dict[str, Any]] = {
        "eta_A": {"verdict": Verdict("weak", "of the test"), "share": 0.6},
        "eta_B": {"verdict": Verdict("at bound"), "std": None, "sigma": None},
        "eta_C": {
            "interval": Interval(-np.inf, 0.9, "profile", ("open", "reached")),
            "share": float("inf"),
            "verdict": Verdict("weak"),
        },
        "theta_A": {"interval": Interval(-np.inf, np.nan, "profile", ("open", "failed")), "share": np.nan},
        "theta_B": {"interval": Interval(-9.0, 9.0, "block bootstrap"), "share": 18 / 0.279},
        "theta_C": {"interval": Interval(0.01, 0.01, "profile", ("at bound", "at bound")), "share": 0.0},
        "a_A": {"verdict": Verdict("no effect"), "std": None, "interval": None, "share": None, "sigma": None},
        "a_B": {"verdict": Verdict("fixed"), "std": None, "interval": None, "share": None, "sigma": None},
    }
    parameters = tuple(replace(e, **changes.get(e.name, {})) for e in whole.parameters)
    ends = {
        "eta_A": {"lower": Side(np.nan, "failed", "of the test")},
        "eta_B": {"upper": Side(0.7049, "at bound", "of the test"), "better": np.zeros(21), "drop": 1.0},
        "eta_C": {
            "lower": Side(-np.inf, "open", "of the test"),
            "upper": Side(np.inf, "open", "of the test"),
        },
        "theta_A": {"lower": Side(-np.inf, "open", ""), "upper": Side(np.nan, "failed", "of the test")},
    }
    told = [replace(p, **ends.get(p.quantity.name, {})) for p in whole.intervals.profiles]
    twice = next(k for k, p in enumerate(told) if p.quantity.name == "theta_B")
    told[twice] = replace(  # the points of a profile that met a bound at once
        told[twice],
        values=np.full(3, told[twice].value),
        rises=np.array([-0.1, 0.0, 0.0]),
        lower=Side(told[twice].value, "open", ""),
        upper=Side(told[twice].value, "at bound", ""),
    )
    stated = {e.name: e.interval for e in parameters if e.interval is not None}
    std = {n: s for n, s in whole.intervals.std.items() if n != "eta_B"}
    known = replace(whole.intervals, std=std, of={**whole.intervals.of, **stated}, profiles=tuple(told))
    return replace(whole, parameters=parameters, intervals=known)


def run_series(
    title: str, pose: Sequence[str], time: np.ndarray | None, errors: Mapping[str, Any]
) -> RunSeries:
    """One run's errors, name -> (n_pose, samples) in SI, as a page shows them; `time` in s."""
    traces = {}
    for name, values in errors.items():
        traces[name] = Trace(1 + len(pose))
        traces[name].add(np.vstack([np.zeros(values.shape[1]) if time is None else time, values]))
    return series_of(title, tuple(pose), traces, timed=time is not None)


def inside(figure: Figure, wide: float = WIDTH) -> None:
    """Nothing of a figure, `wide` inches, is beyond its edge."""
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert width == wide
    assert min(drawn.x0, drawn.y0) >= 0
    assert drawn.x1 <= width
    assert drawn.y1 <= height
