"""The error of a sensor over its period, split by what removes it, where the truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import hallsym
from hallsym.families.recording import as_read
from hallsym.report.content import text_of
from hallsym.report.data.periodic import periodic_error, periodic_of
from hallsym.report.results.periodic import periodic

DEG = np.pi / 180
REAL = Path(__file__).parents[3] / "shared" / "real" / "rotary-mechaduino-luts"


def of(columns, model="rotary", noise=None):
    log = hallsym.read_log(columns, noise=noise)
    fit = hallsym.fit(log, model, solver="direct")
    return fit, periodic_error(as_read(log, fit.model, fit.corrections), fit)


def table(sizes, pattern=0.0, sigma=0.01, knots=200, seed=1):
    """Return knots of an encoder with sine waves of these amplitudes [deg] and a stepper's pattern [deg]."""
    at = 2 * np.pi * np.arange(knots) / knots
    error = sum(a * np.sin(n * at + n) for n, a in sizes.items())
    scatter = np.random.default_rng(seed).normal(0, sigma, knots)
    reference = at + DEG * pattern * np.sin(50 * at + 0.3)
    return {"angle_rad": at + DEG * (error + scatter), "angle_ref_rad": reference}


def test_a_table_of_knots_is_split_into_encoder_reference_and_noise():
    sizes = {1: 0.35, 2: 0.4, 4: 0.13}
    fit, found = of(table(sizes, pattern=0.05))
    shown = {h.per_period: h for h in found.harmonics if h.shown}
    assert {1, 2, 4, 50} <= set(shown) <= {1, 2, 4, 50, 100}
    for n, amplitude in {**sizes, 50: 0.05}.items():
        assert shown[n].amplitude / DEG == pytest.approx(amplitude, abs=2 * shown[n].half_width / DEG)
        assert shown[n].half_width / DEG == pytest.approx(1.96 * 0.01 * (2 / 200) ** 0.5, rel=0.3)
    assert found.machine.rms / DEG == pytest.approx(np.sqrt((0.35**2 + 0.4**2 + 0.13**2) / 2), abs=0.003)
    assert found.mounted.rms / DEG == pytest.approx(0.13 / 2**0.5, abs=0.003)
    assert found.mounted.peak / DEG == pytest.approx(0.13, abs=0.005)
    assert found.calibrated.rms / DEG == pytest.approx(0.13 / 2**0.5, abs=0.005)  # an ellipse has no fourth
    assert found.pattern.rms / DEG == pytest.approx(0.05 / 2**0.5, abs=0.003)
    assert found.rest / DEG == pytest.approx(0.01, rel=0.2)
    assert (found.mount_orders, found.pattern_orders, found.slope) == ((1, 2), (50, 100), 0.0)
    assert "reference_eccentricity" in found.elsewhere[1]
    assert "gain_mismatch" in found.elsewhere[2]
    text = fit.summary()
    assert "pattern of the reference, no error of the encoder: 50: 0.05" in text
    assert "mounted anew, at best without waves 1 and 2 per turn" in text
    assert "2 per turn may also come from gain_mismatch" in text


def half_supply(centre: float):
    """Return voltages about a centre [V] that a nominal centre of zero does not expect."""
    angle = 2 * np.pi * np.arange(2000) / 400
    noise = np.random.default_rng(2).normal(0, 0.004, (2, angle.size))
    volts = {"v_sin_v": centre + np.sin(angle) + noise[0], "v_cos_v": centre + np.cos(angle) + noise[1]}
    return volts | {"angle_ref_rad": angle}


def test_voltages_about_half_the_supply_are_not_split_by_a_nominal_centre_of_zero():
    fit, found = of(half_supply(2.5))
    assert found.rest_calibrated == pytest.approx(0.004, rel=0.1)
    assert found.rest > 10 * found.rest_calibrated
    text = fit.summary()
    assert "the nominal parameters do not decode these readings" in text
    assert f"rms {found.rest_calibrated / DEG:.3g} deg" in text
    assert "mounted anew" not in text


def test_noise_alone_is_no_error_of_the_encoder():
    fit, found = of(table({1: 0.0}, sigma=0.02))
    assert (found.machine.rms, found.pattern.rms) == (0.0, 0.0)
    assert found.rest / DEG == pytest.approx(0.02, rel=0.2)
    assert "none that the log shows" in fit.summary()


def voltages(ratio, latency_s=0.0, turns=3.0, scale=0.0):
    """Return two voltages of unequal amplitude, to and fro, read late."""
    t = np.arange(0, 2, 1e-3)
    angle = 2 * np.pi * turns * (1 - np.abs(1 - t)) + 0.2
    late = 2 * np.pi * turns * (1 - np.abs(1 - (t - latency_s))) + 0.2
    rng = np.random.default_rng(2)
    return {
        "run": np.zeros(len(t), int), "t_s": t,
        "v_sin_v": ratio * np.sin(late) + rng.normal(0, 3e-4, len(t)),
        "v_cos_v": np.cos(late) + rng.normal(0, 3e-4, len(t)),
        "angle_ref_rad": angle * (1 + scale) + rng.normal(0, 1e-5, len(t)),
    }  # fmt: skip


@pytest.mark.parametrize("latency", [0.0, 5e-3])
def test_unequal_amplitudes_make_the_series_of_the_arctangent(latency):
    """atan2(r sin a, cos a) - a = sum q^n / n sin(2 n a), q = (r - 1) / (r + 1), whichever way it turns."""
    _, found = of(voltages(1.06, latency))
    q = 0.06 / 2.06
    by_order = {h.per_period: h.amplitude for h in found.harmonics}
    assert by_order[2] == pytest.approx(q, rel=0.03)  # where the motion turns round, a late reading is off
    assert latency or by_order[4] == pytest.approx(q**2 / 2, rel=0.1)
    assert found.calibrated.rms < 0.01 * found.machine.rms


def test_another_scale_of_the_reference_is_no_wave_of_the_encoder():
    _, found = of(voltages(1.06, scale=2e-3))
    assert found.slope == pytest.approx(-2e-3, rel=0.02)
    shown = {h.per_period for h in found.harmonics if h.shown and h.amplitude > 0.01 * 0.03}
    assert shown <= {2, 4}


def test_nothing_is_said_of_part_of_a_turn_and_of_what_does_not_repeat():
    at = np.linspace(0, 340 * DEG, 400)
    assert of({"angle_rad": at + 0.01 * np.sin(at), "angle_ref_rad": at})[1] is None
    assert "by remedy" not in hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct").summary()


def test_evaluate_says_what_the_encoder_of_the_next_log_makes():
    fit, _ = of(table({1: 0.3, 2: 0.4}))
    found = hallsym.evaluate(fit, hallsym.read_log(table({1: 0.1, 2: 0.4}, seed=5)))
    text = found.summary()
    assert "wave per turn of the encoder: 1: 0.099, 2: 0.4 deg" in text
    calibrated = next(line for line in text.splitlines() if line.startswith("with this calibration"))
    assert float(calibrated.split()[-1]) == pytest.approx(0.2, abs=0.01)  # the mounting has changed


@pytest.mark.skipif(not REAL.exists(), reason="the recordings of real encoders are not beside this checkout")
@pytest.mark.parametrize(("name", "waves"), [
    ("h01_kaiwol1990_a", {1: 0.14, 2: 0.19}), ("h12_willchurch_j", {2: 0.19, 4: 0.287}),
])  # fmt: skip
def test_real_encoders_have_the_waves_that_are_known_of_them(name, waves):
    columns = {"angle_count": "raw_count", "angle_ref_deg": "ref_angle_deg"}
    log = hallsym.read_log(REAL / f"{name}_knots.csv", columns=columns, counts_per_turn=16384)
    fit = hallsym.fit(log, "rotary", solver="direct")
    found = periodic_error(as_read(log, fit.model, fit.corrections), fit, fit.keep)
    by_order = {h.per_period: h.amplitude / DEG for h in found.harmonics}
    for n, amplitude in waves.items():
        assert by_order[n] == pytest.approx(amplitude, abs=0.006)


@pytest.mark.slow
def test_a_diagnosis_says_as_a_fit_does_that_nominal_parameters_do_not_decode():
    found = hallsym.diagnose(half_supply(2.5), "rotary")
    assert all(w.designed is None and not w.absorbed for w in found.waves)
    words = " ".join(found.summary().split())
    assert "No nominal waves: the nominal parameters do not decode these readings." in words
    assert max((w.model for w in found.waves), default=0.0) < 0.1 * DEG


@pytest.mark.parametrize(("ratio", "decodes"), [(1.8, True), (2.2, False)])
def test_nominal_parameters_decode_while_they_leave_less_than_twice_what_fitted_ones_do(ratio, decodes):
    fit, found = of(table({1: 0.35, 2: 0.4}))
    text = text_of(periodic(replace(found, rest=ratio * found.rest_calibrated), fit.model.family))
    assert ("do not decode these readings" not in text) == decodes


def test_a_correction_is_made_once_on_the_log_of_a_fit():
    """The log that a fit keeps is read already; a mounted sensor of the other sign has the same error."""
    angle = 2 * np.pi * np.arange(2000) / 400
    noise = np.random.default_rng(3).normal(0, 0.004, (2, angle.size))
    volts = {"v_sin_v": -(np.sin(angle) + noise[0]), "v_cos_v": np.cos(angle) + noise[1]}
    log = hallsym.read_log({**volts, "angle_ref_rad": angle, "t_s": 1e-3 * np.arange(angle.size)})
    fit = hallsym.fit(log, "rotary", solver="direct")
    assert [one.text for one in fit.corrections] == ["sign v_sin_v"]
    kept, raw = periodic_of(fit), periodic_of(fit, log)
    assert max(h.amplitude for h in kept.harmonics) < 1e-3
    assert [h.amplitude for h in kept.harmonics] == pytest.approx([h.amplitude for h in raw.harmonics])
