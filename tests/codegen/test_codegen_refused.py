"""What C is not generated from: each is refused by what stands against it, in a sentence."""

import re
from dataclasses import replace
from functools import partial

import boards
import casadi as ca
import numpy as np
import pytest
from calibrations import ELLIPSE, LAYOUTS, ROTARY, clipped, fit_of
from calibrations import encoder as calibrated
from firmware import calibration, with_effect
from msgspec import structs
from test_codegen_correction import curve
from twins import with_arrays
from waves import LENGTH, sums
from waves import calibrated as wave

from hallsym.codegen import generate
from hallsym.codegen.lowering.correction import smallest_correction
from hallsym.errors import InputError
from hallsym.families import adapted, effects
from hallsym.families.rotary import models as rotary

BASE = rotary.rotary(LAYOUTS["volts"])


def changed(change, **options):
    return lambda: generate(change(calibration()), **options)


def stated(text, value=0.01):
    """A stage with an effect as `--effect` takes it."""
    return lambda: generate(with_effect(lambda model: adapted(model, (text,), {}), value))


def encoder(effect):
    return lambda: generate(calibrated(effect(BASE), ELLIPSE))


def q31(case, **options):
    return lambda: generate(fit_of(case), arithmetic="q31", **options)


def bump():
    def step(s, p):
        s["gain"] = s["gain"] * ca.exp(100 * s["z_m"])

    return generate(with_effect(lambda model: model.with_step("transducer", step, effect="bump")))


def bent():
    def step(s, p):
        s["reading"] = s["reading"] / (1 + 0.01 * s["reading"] ** 2)

    return generate(wave(sums().with_step("electronics", step, effect="soft_clipping")))


def half_a_board():
    def step(s, p):
        s["reading"] = s["reading"][:6]

    fit = fit_of("12 sums")
    half = fit.model.with_step("electronics", step, effect="half_a_board")
    half = replace(half, channels=fit.model.channels[:6])
    return generate(wave(half, fit.model.named(fit.values)).changed(log=fit.log))


REFUSED = {
    "a fit that did not end": (changed(lambda f: f.changed(status="interrupted")), "did not converge"),
    "an undetermined parameter": (
        changed(lambda f: f.changed(undetermined_by_log=("a_A",))), "does not determine a_A"
    ),
    "no ranges": (changed(lambda f: f.changed(log=structs.replace(f.log, span={}))), "--range x_m"),
    "no number": (changed(lambda f: with_arrays(f, values=np.append(np.nan, f.values[1:]))), "not finite"),
    "a gain through zero": (
        changed(lambda f: f, ranges={"z_m": (-5e-3, 5e-3)}), "gain of hall_a_m falls to"
    ),
    **{
        name: (stated(text, 1e-3), rf"with .*{name} needs \w.* from a whole log")
        for name, text in (
            ("time_skew", "time_skew"), ("first_order_lag", "first_order_lag:per=probe"),
            ("hysteresis", "hysteresis:half_width_m=1e-5"), ("mains_hum", "mains_hum:frequency_hz=50"),
            ("offset_time_drift", "offset_time_drift:duration_s=60,degree=2"),
        )
    },
    "rails": (
        stated("saturation:low_m=-4e-4/-4e-4/-4e-4,high_m=4e-4/4e-4/4e-4"), "no polynomial of pose and state"
    ),
    "powers without end": (stated("cross_axis_sensitivity:order=3"), "spread too far"),
    "a square that turns back": (
        lambda: generate(with_effect(effects()["even_nonlinearity"], 0.3)), "do not settle"
    ),
    "no polynomial": (bump, "polynomials"),
    "an accuracy of a stage": (changed(lambda f: f, accuracy=1e-6), "--accuracy belongs to families"),
    "integers of an iterated model": (
        lambda: generate(fit_of("cubic"), arithmetic="q31"), r"linear in the pose; .* has its C in float"
    ),
    "jacobian of integers": (
        changed(lambda f: f, arithmetic="q31", jacobian=True), "--jacobian belongs to --arithmetic float"
    ),
    "an encoder's temperature": (
        encoder(partial(ROTARY["gain_temperature_drift"], mean_degc=20.0)),
        "depend on the angle alone; rotary with gain_temperature_drift needs temperature_degc",
    ),
    "errors of a reference": (encoder(ROTARY["reference_pole_pairs"]), "errors of its reference"),
    "an encoder's history": (encoder(ROTARY["time_skew"]), "computed from a whole log"),
    "slopes of an encoder": (
        lambda: generate(fit_of("ellipse volts"), jacobian=True), "--jacobian is not generated for rotary"
    ),
    "more than a turn": (
        lambda: generate(fit_of("ellipse angle"), ranges={"angle_rad": (-10.0, 10.0)}),
        "within one turn in either direction",
    ),
    "a negative accuracy": (
        lambda: generate(fit_of("meng angle"), accuracy=-1.0), "must be a positive angle"
    ),
    "the code of another version": (
        lambda: smallest_correction(curve("meng angle"), None, "series:6"), "--force"
    ),
    "rails that no table follows": (
        lambda: generate(clipped()), r"1024 entries; .* rad \(.* deg\) is within reach"
    ),
    "two rails at once": (lambda: generate(clipped(0.6), accuracy=0.01), "too large to be undone"),
    "a range of binary angles": (q31("meng angle", ranges={"angle_rad": (0, 1)}), "every bit pattern"),
    "rails in integers": (q31("clipped"), "1024 entries; .* is within reach"),
    "no wave": (bent, r"differs from that by .* without that effect"),
    "too near": (lambda: generate(wave(gaps=(0.0, 0.01))), "too strong at the least gap"),
    "cosine alone": (lambda: generate(wave(sums(2, LENGTH / 2), {})), "do not tell cosine from sine"),
    "a wave in integers": (
        lambda: generate(wave(), arithmetic="q31"),
        "has its C in float, which runs without a floating-point unit too",
    ),
    "two arrays": (half_a_board, "show 2 along x_m and 0 along y_m"),
    "an array beyond its board": (
        lambda: generate(boards.travel(reach=0.14)), r"too few sensors see .* to tell x_m and which period"
    ),
}  # fmt: skip
LATER = ("an array beyond its board",)


@pytest.mark.parametrize(
    "what", [pytest.param(w, marks=pytest.mark.slow if w in LATER else ()) for w in REFUSED]
)
def test_it_is_refused_in_one_sentence(what):
    call, says = REFUSED[what]
    with pytest.raises(InputError, match=says) as refused:
        call()
    assert len(re.findall(r"\. [A-Z]", str(refused.value))) == (what == "no polynomial")  # and what to do
