"""The table of mistakes that a lab makes: what each does to a log, what must be said, and how it ends.

A row is added where a mistake is learnt; `test_mistakes.py` makes each of them in every log it applies to.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

import numpy as np

from hallsym.families import build, published
from hallsym.log import Log, Noise, Sigma
from hallsym.simulation import Campaign, NoiseModel, Run, paper_campaign, read_campaign, simulate
from hallsym.simulation.paper import VERTICAL_NOISE
from hallsym.simulation.signals import multi_sine

Arrays = dict[str, np.ndarray]
Make = Callable[[Arrays], Arrays | None]
"""Make the mistake in a copy of a log's arrays: in place, or return the arrays of another log."""

STAGE = ("57 runs", "6 runs")
ENCODER = ("encoder",)
SIGMA = {"hall_a_m": 5e-7, "hall_b_m": 5e-7, "hall_c_m": 5e-7, "x_ref_m": 1e-6, "y_ref_m": 1.4e-6}
SIGMA |= {"rz_ref_rad": 5e-7} | VERTICAL_NOISE
ENCODER_SIGMA = {"v_sin_v": 3.5e-4, "v_cos_v": 3.5e-4, "angle_ref_rad": 2e-5}


@dataclass(frozen=True)
class Mistake:
    """One mistake. `says`: a regular expression that one sentence must match; it names column, run, remedy.

    `ends`: "refusal" (exit 2) or "note" (exit 0 or 3). `found`: from the "log" alone, or by the "fit" of its
    model. `on`: the base logs in which it is made.
    """

    name: str
    make: Make
    says: str
    ends: Literal["refusal", "note"]
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
        model, sigma = build("stage31"), SIGMA
        truth = published.values("table7_estimates")
        arrays = simulate(model, truth, campaign, NoiseModel(sigma), seed=1)
    return arrays, Noise({column: Sigma(value, "given") for column, value in sigma.items()})


def six_runs() -> Campaign:
    """Return six runs in which all axes move together, each at another vertical setting of Table 6."""
    settings = published.table("table6_settings")
    motion = {
        "x_m": multi_sine(300e-6, [1.0, 4.0]),
        "y_m": multi_sine(500e-6, [2.0, 5.0]),
        "rz_rad": multi_sine(300e-6, [3.0, 7.0]),
    }
    at = [{axis: settings[axis][k] for axis in ("z_m", "rx_rad", "ry_rad")} for k in (0, 4, 8, 12, 15, 18)]
    return Campaign(2e-3, tuple(Run(1.0, setting, motion) for setting in at))


# -- what a log reveals by itself ------------------------------------------------------------------------


def put(column: str, rows: object, value: object) -> Make:
    """Put a value into rows of a column."""

    def make(arrays: Arrays) -> None:
        arrays[column][rows] = value  # type: ignore[index]

    return make


RECORDING = (
    Mistake(
        "a reading that is NaN in two samples",
        put("hall_a_m", [450, 900], np.nan),
        r"hall_a_m .* 2 of \d+ values are NaN .* row 451 \(run 0\).*repair",
        "refusal",
    ),
)

MISTAKES = (*RECORDING,)
