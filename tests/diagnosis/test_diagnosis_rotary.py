"""Diagnosis of encoders: machines written in numpy hide one cause each, the diagnosis names it.

Facts used beside the machines: waves of angle error per turn of a field harmonic, the phase of a low-pass,
the field of a dipole off its axis.
"""

from dataclasses import replace

import numpy as np
import pytest

from hallsym.diagnosis import Estimate, diagnose
from hallsym.diagnosis.record import Gap, NoiseFloor
from hallsym.diagnosis.words import shown
from hallsym.families import effects
from hallsym.families.rotary import FAMILY as ROTARY_FAMILY
from hallsym.families.rotary import effects as rotary_effects
from hallsym.families.rotary import models as rotary
from hallsym.log import Log, Meta, Noise
from hallsym.model.derived import Stretch
from hallsym.report.views import summary

CATALOGUE = tuple(e for e in effects(ROTARY_FAMILY).values() if e.diagnosed)
TURN = 2 * np.pi
SIGMA = 6e-4
SPEEDS = (3.0, -3.0, 12.0, -12.0, 60.0, -60.0, 150.0, -150.0)
HELD = (2, 5)
ANGLES = np.linspace(0.1, 0.1 + TURN, 400)


def machine(cause=None, model="ellipse", seed=1, noise=SIGMA):
    """Eight runs at constant speeds; `cause(phase, speed, run, t)` changes angle and voltages."""
    rng = np.random.default_rng(seed)
    parts = []
    for run, w in enumerate(SPEEDS):
        t = np.arange(300) * (0.008 if abs(w) < 20 else 5e-4)
        a = rng.uniform(0, TURN) + w * t
        true, sine, cosine, logged = a + 0.7, np.sin, np.cos, a
        late, add_sin, add_cos, off = 0.0, 0.0, 0.0, 0.0
        if cause is not None:
            late, add_sin, add_cos, off = cause(true, w, run, 20.0 * run + t)
        v_sin, v_cos = sine(true + late) + add_sin, cosine(true + late) + add_cos
        if model == "ellipse":
            v_sin, v_cos = 1.004 * v_sin + 0.003, 0.997 * v_cos - 0.002
        parts.append((np.full(300, run), 20.0 * run + t, v_sin, v_cos, logged + off))
    names = ("run", "t_s", "v_sin_v", "v_cos_v", "angle_ref_rad")
    columns = {n: np.concatenate(x) for n, x in zip(names, zip(*parts, strict=True), strict=True)}
    for n in ("v_sin_v", "v_cos_v"):
        columns[n] = columns[n] + noise * rng.standard_normal(len(columns[n]))
    columns["angle_ref_rad"] = columns["angle_ref_rad"] + 3e-5 * rng.standard_normal(len(columns["run"]))
    sigmas = {"v_sin_v": noise, "v_cos_v": noise, "angle_ref_rad": 3e-5}
    meta = Meta(base_model=model, holdout=HELD)
    return Log.from_arrays(columns, Noise.given(sigmas, tuple(columns)), meta, "a hidden encoder")


def third(u, w, run, t):
    return 0.0, 2e-3 * np.sin(3 * u), -2e-3 * np.cos(3 * u), 0.0  # -2e-3 exp(-3 i u)


def latency(u, w, run, t):
    return -2.5e-5 * w, 0.0, 0.0, 0.0


def play(u, w, run, t):
    return -1.2e-3 * np.sign(w), 0.0, 0.0, 0.0


def squares(u, w, run, t):
    return 0.0, 3e-3 * np.sin(u) ** 2, -2e-3 * np.cos(u) ** 2, 0.0


def reference_once(u, w, run, t):
    return 0.0, 0.0, 0.0, 2.5e-3 * np.sin(u - 0.7)


def switched(u, w, run, t):
    return 0.0, 3e-3 * (run in (3, 4, 6)), -2e-3 * (run in (3, 4, 6)), 0.0


def pole_pairs(u, w, run, t):
    return 0.0, 0.0, 0.0, 2e-3 * np.cos(50 * (u - 0.7))


def bearing(u, w, run, t):
    return 0.0, 3e-3 * np.sin(5.62 * u), 2e-3 * np.cos(5.62 * u), 0.0


def offset(u, w, run, t):
    return 0.0, 1.8e-3, -0.9e-3, 0.0


NAMED = (
    (third, "third_harmonic_distortion", {"field_saturation", "odd_nonlinearity"}),
    (latency, "time_skew", {"first_order_lag"}),
    (play, "hysteresis", set()),
    pytest.param(squares, "even_nonlinearity", set(), marks=pytest.mark.slow),
    pytest.param(
        reference_once, "reference_eccentricity", {"eccentricity", "magnet_tilt"}, marks=pytest.mark.slow
    ),
    pytest.param(switched, "uniform_stray_field", set(), marks=pytest.mark.slow),
    (pole_pairs, "reference_pole_pairs", set()),
)


@pytest.mark.parametrize(("cause", "name", "alike"), NAMED)
def test_names_the_cause_or_its_group(cause, name, alike):
    found = diagnose(machine(cause))
    assert found.verdict == "explained"
    first = next((set(g) for g in found.groups if found.ranked[0] in g), {found.ranked[0]})
    assert name in first
    assert first <= {name, *alike}
    assert found.metric.after < 1.05 * found.metric.floor
    link = next(e.link for e in CATALOGUE if e.name == name)
    assert link == "reference" or not name.startswith("reference")


@pytest.mark.slow
def test_an_offset_of_the_ideal_encoder_is_no_eccentricity():
    """Off the axis there is a second harmonic as large as the constant part; here there is none."""
    found = diagnose(machine(offset, "ideal_arctan"))
    assert set(found.groups[0]) == {"offset_error", "uniform_stray_field"}


@pytest.mark.parametrize("model", ["ellipse", "ideal_arctan"])
def test_no_gap_without_a_cause(model):
    found = diagnose(machine(None, model) if model == "ellipse" else machine(None, model, seed=2))
    assert found.verdict == "no gap"
    assert "deg" in found.sentence


@pytest.mark.parametrize("change", ["swap", "sign"])
def test_miswired_plates_are_a_group(change):
    """Either turns the angle round, and its zero is free."""
    log = machine()
    columns = {c: log.array(c) for c in log.columns}
    if change == "swap":
        columns["v_sin_v"], columns["v_cos_v"] = columns["v_cos_v"], columns["v_sin_v"]
    else:
        columns["v_cos_v"] = -columns["v_cos_v"]
    found = diagnose(Log.from_arrays(columns, log.noise, log.meta, "a miswired encoder"))
    assert found.verdict == "explained"
    assert set(found.groups[0]) == {"sign_inversion", "channel_swap"}


def test_angles_of_an_encoder_are_read_in_degrees():
    """As the documentation says; an angle that is a parameter is in degrees for every family."""
    estimate = Estimate(np.radians(0.7), 1e-5, "rad")
    found = diagnose(machine(third))
    effect = replace(found.effects[0], parameters={"skewed": estimate})
    assert "skewed 0.70000(57) deg" in " ".join(summary(replace(found, effects=(effect,))).split())
    gap, floor = Gap({"rz_rad": 1e-6}, {"rz_rad": 1e-6}), NoiseFloor({"rz_rad": 1e-7}, "stated")
    stage = replace(found, effects=(effect,), noise_floor=floor, gap_before=gap, gap_after=gap, waves=())
    assert "skewed 0.70000(57) deg" in " ".join(summary(stage).split())
    assert shown(2 * np.pi, "rad/s") == "60 rpm"


# -- the effects themselves ------------------------------------------------------------------------------


def readings(model, values, columns=None):
    p = model.vector({"A": 1.0, "zero": 0.0, **values})
    state = [np.broadcast_to((columns or {})[c], ANGLES.shape) for c in model.state]
    return np.array(model.reading(p, [], ANGLES[None], np.array(state).reshape(len(state), len(ANGLES))))


@pytest.mark.parametrize(("order", "waves"), [(2, 1), (0, 1), (-1, 2), (3, 2), (-3, 4)])
def test_a_field_harmonic_is_its_waves_per_turn(order, waves):
    wide = rotary_effects.field_harmonics(rotary.rotary_ideal(), "x", "field", (order,))
    model = rotary_effects.direct(wide)
    sine, cosine = readings(model, {f"x_{order}_re".replace("-", "m"): 1e-4})
    error = np.angle((cosine + 1j * sine) * np.exp(-1j * ANGLES))
    power = [abs(np.mean(error * np.exp(-1j * n * ANGLES))) for n in range(1, 7)]
    assert 1 + int(np.argmax(power)) == waves


def test_a_low_pass_has_the_phase_and_amplitude_of_its_transfer_function():
    model = rotary_effects.direct(effects(ROTARY_FAMILY)["first_order_lag"](rotary.rotary_ideal()))
    sine, cosine = readings(model, {"lag": 2e-3}, {"d1_angle_ref_rad": 150.0})
    turned = (cosine + 1j * sine) * np.exp(-1j * ANGLES)
    assert np.allclose(turned, 1 / (1 + 1j * 150.0 * 2e-3), atol=1e-12)


def test_off_axis_is_a_dipole():
    """The field of a dipole in numpy, chip and magnet 30 and 24 um off at a gap of 3 mm: 0.018^4 is left."""
    gap, chip, magnet, towards = 3e-3, 3e-5, 2.4e-5 * np.exp(0.6j), 0.9
    w = chip * np.exp(1j * (towards - ANGLES)) - magnet
    r = np.array([w.real, w.imag, np.full_like(ANGLES, gap)])
    m = np.array([[1.0], [0.0], [0.0]])
    B = 3 * (m * r).sum(axis=0) * r / np.linalg.norm(r, axis=0) ** 5 - m / np.linalg.norm(r, axis=0) ** 3
    field = -(B[0] + 1j * B[1]) * gap**3 * np.exp(1j * ANGLES)
    a = -3 / gap**2
    both = -a * chip * magnet * np.exp(-1j * towards)
    values = {"e_both_re": both.real, "e_both_im": both.imag, "e_chip": a / 2 * chip**2}
    model = rotary_effects.direct(rotary_effects.off_axis(rotary.rotary_ideal(), "e", towards))
    sine, cosine = readings(model, values)
    level = 1 + a * (chip**2 + abs(magnet) ** 2) + a / 2 * magnet**2
    assert np.abs(cosine + 1j * sine - field - (1 - level) * np.exp(1j * ANGLES)).max() < 2e-6
    assert np.abs(field - np.exp(1j * ANGLES)).max() > 2e-4


def test_direction_turns_over_after_a_reversal():
    u = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)[1:]])
    stretch = Stretch(0, {"angle_ref_rad": u, "t_s": np.arange(201) * 0.01}, 0.0, 0.0, {}, {})
    z = rotary_effects.direction(0.02).rule(stretch)
    assert np.allclose(z[5:90], 1.0)
    assert np.allclose(z[112:], -1.0)
    assert z[0] == 0.0  # from where it came is not known


@pytest.mark.parametrize("layout", [None, rotary.angle_only()], ids=["voltages", "angle"])
def test_direct_reads_what_the_series_reads(layout):
    model = effects(ROTARY_FAMILY)["gain_mismatch"](rotary.rotary_ideal(layout))
    values = {"mismatch": 0.01, "zero": 0.3}
    assert np.allclose(
        readings(model, values), readings(rotary_effects.direct(model), values), rtol=0, atol=1e-9
    )


def test_what_no_effect_explains_is_said():
    assert diagnose(machine(bearing)).verdict == "unexplained"
