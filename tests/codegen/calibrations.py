"""Calibrations of every family by name, and the C that is generated from them, once a process."""

from collections.abc import Callable
from functools import cache
from typing import Any

import boards
import numpy as np
from firmware import STAGES, known
from waves import VALUES, sums
from waves import calibrated as wave

import hallsym
from hallsym import Fit, Model
from hallsym.codegen import Generated
from hallsym.estimation.calibration import LogRecord
from hallsym.families import effects, halbach
from hallsym.families.rotary import FAMILY as ROTARY_FAMILY
from hallsym.families.rotary import models as rotary
from hallsym.families.rotary import rings
from hallsym.families.stage import models as stage
from hallsym.log import Noise, Sigma

ROTARY = effects(ROTARY_FAMILY)
ELLIPSE = {"Vx": 0.02, "Vy": -0.03, "Ax": 1.02, "Ay": 0.99, "beta": 0.02, "zero": 2.9}
PAPER = {k: v for k, v in ROTARY_FAMILY.example.values.items() if k != "A"}
WAVES = {"h3c": 2e-3, "h3s": -1e-3, "h4c": 3e-3, "h8s": 1e-3}
ENCODERS: dict[str, tuple[Callable[..., Model], dict[str, float]]] = {
    "ideal": (rotary.rotary_ideal, {"A": 1.3, "zero": -2.0}),
    "ellipse": (rotary.rotary, ELLIPSE),
    "meng": (rotary.rotary_meng, PAPER),
    "harmonics": (lambda layout: rotary.harmonics(rotary.rotary(layout)), {**ELLIPSE, **WAVES}),
    "eccentric": (
        lambda layout: ROTARY["eccentricity"](rotary.rotary(layout), direction_deg=np.degrees(0.3)),
        {**ELLIPSE, "eccentricity_both_re": 0.01, "eccentricity_both_im": -0.02, "eccentricity_chip": 0.015},
    ),
}
LAYOUTS = {"volts": rotary.two_voltages(), "angle": rotary.angle_only()}


def encoder(model: Model, values: dict[str, float]) -> Fit:
    """A calibration of an encoder at known parameters."""
    p = model.vector({k: v for k, v in values.items() if k in model.names})
    return known(
        model, p, errors=None, error_rows={}, noise_floor={},
        noise=Noise({c: Sigma(3e-4, "given") for c in (*model.channels, *model.references)}),
        log=LogRecord(span={"angle_ref_rad": (0.0, 12.0), "temperature_degc": (20.0, 30.0)}, sha256=64 * "0"),
    )  # fmt: skip


def clipped(level: float = 0.8) -> Fit:
    """An encoder whose voltages stop at rails."""
    model = hallsym.build("rotary", added=(f"saturation:low_v=-{level}/-{level},high_v={level}/{level}",))
    return encoder(model, {**ELLIPSE, "clipped_sin": 1.0, "clipped_cos": 1.0})


def ring() -> Fit:
    model = rings.rings3(rings.heads(5, 4, "v"))
    p = model.vector({"V1": 0.03, "V3": -0.02, "A2": 1.04, "A4": 0.95, "place_3": 0.64})
    noise = Noise({c: Sigma(1e-3, "given") for c in (*model.channels, *model.references)})
    return known(model, p, noise=noise, log=LogRecord())


def five_probes() -> Fit:
    at = {"d": ((-0.2, -0.33), (0.8, 0.6)), "e": ((0.25, -0.1), (-0.28, 0.96))}
    more = (stage.Probe(f"hall_{n}_m", *place) for n, place in at.items())
    model = stage.stage31((*stage.paper_layout(), *more))
    given = {f"eta_{k}": 0.8 + 0.03 * n for n, k in enumerate("ABCDE")}
    given |= {f"{q}_{k}": 40.0 * (n - 2) for q in "abc" for n, k in enumerate("ABCDE")}
    return known(model, model.vector(given), noise=Noise({c: Sigma(5e-7, "given") for c in model.channels}))


def halbach_array() -> Fit:
    values = {"a1": 0.62, "b1": 0.11, "a5": -6e-4, "b5": -8e-4}
    return wave(halbach.models.halbach(), values, gaps=(0.0042, 0.0062))


NINE = {**VALUES, **{f"g{k}": 4 * (1 + 0.01 * np.sin(3 * k)) for k in range(9)}}
NINE |= {f"dx{k}": 3e-5 * np.cos(5 * k) for k in range(9)}
CASES: dict[str, Callable[[], Fit]] = {
    **STAGES,
    "five probes": five_probes,
    **{f"{case} {form}": lambda make=make, form=form, values=values: encoder(make(LAYOUTS[form]), values)
       for case, (make, values) in ENCODERS.items() for form in LAYOUTS},
    "clipped": clipped,
    "five Halls": ring,
    "three sums": wave,
    "five sums": lambda: wave(sums(5), {**VALUES, "g4": 4.4}),
    "nine sums": lambda: wave(sums(9), NINE),
    "first harmonic alone": lambda: wave(values={"A5": 0.0}),
    "second harmonic": lambda: wave(values={**VALUES, "A2": 5e-3, "wavelength": 0.03017}),
    "halbach": halbach_array,
    **{name: make for name, (make, _) in boards.BOARDS.items()},
}  # fmt: skip


@cache
def fit_of(case: str) -> Fit:
    """The calibration of a case."""
    return CASES[case]()


@cache
def made(case: str, **variant: Any) -> Generated:
    """Generated code of a case, to the accuracy of its board where nothing else is said."""
    accuracy = boards.BOARDS[case][1] if case in boards.BOARDS else None
    return hallsym.generate(fit_of(case), **{"accuracy": accuracy, **variant})
