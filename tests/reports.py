"""Reports on what data determine, of which tests draw pictures, and what holds for every picture."""

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from twins import SIGMAS, TRUTH, record, with_noise

from hallsym.estimation import fit
from hallsym.families import build
from hallsym.inference import Identifiability, identify
from hallsym.report.data.gather import RunSeries, Trace, series_of
from hallsym.report.drawing import WIDTH
from hallsym.simulation import Campaign, NoiseModel, Run, simulate, sine

HOLDOUT = (2, 7, 12)


@cache
def full() -> Identifiability:
    """The paper's campaign: three structural pairs, everything else determined."""
    return identify(fit(with_noise(record(seed=1)), "stage31", solver="direct", loss="none"), profiles="none")


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
    figure.draw_without_rendering()  # which finds the margins
    drawn, (width, height) = figure.get_tightbbox(), figure.get_size_inches()
    assert width == wide
    assert min(drawn.x0, drawn.y0) >= 0
    assert drawn.x1 <= width
    assert drawn.y1 <= height
