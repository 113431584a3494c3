"""A chip's CORDIC, found in the values of its angle.

Facts: the values that the arithmetic itself gives; an arctangent of n steps is off by atan(2^-(n-1)) at most
(Volder 1959); the zero register turns all values; counts of b bits lie 2 pi / 2^b apart.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hallsym
from hallsym.cli.main import main
from hallsym.diagnosis import POLICY, diagnose
from hallsym.diagnosis.faults import cordic
from hallsym.families.cordic import cordic_angle, levels, worst_of
from hallsym.log import Log, Meta, Noise
from hallsym.simulation import read_campaign

TURN = 2 * np.pi
CAMPAIGN = Path(__file__).resolve().parents[2] / "data" / "encoder" / "campaign.toml"


def rounded(angle, bits):
    return angle if bits is None else np.round(angle / TURN * 2**bits) / 2**bits * TURN


def chip(steps, count, seed, bits=None, zero=0.0):
    """Angles of a chip at random places."""
    a = np.random.default_rng(seed).uniform(-np.pi, np.pi, count)
    return rounded(cordic_angle(np.sin(a), np.cos(a), steps) + zero, bits)


@pytest.mark.parametrize("steps", [1, 4, 7, 9])
def test_levels_are_what_the_arithmetic_gives(steps):
    a = np.linspace(-np.pi, np.pi, 200_001)[:-1] + 1e-6
    found = cordic_angle(np.sin(a), np.cos(a), steps)
    k = levels(steps)
    seen = np.unique(np.round(np.mod(found, TURN), 9))
    both = np.unique(np.round(np.mod(np.concatenate([k.angles, k.angles + np.pi]), TURN), 9))
    assert seen == pytest.approx(both, abs=2e-9)
    assert k.rms == pytest.approx(np.sqrt(np.mean((found - a) ** 2)), rel=1e-3)
    assert np.abs(found - a).max() == pytest.approx(k.worst, rel=1e-3)
    assert k.worst <= np.arctan(2.0 ** (1 - steps)) * (1 + 1e-9)


@settings(max_examples=25, deadline=None)
@given(steps=st.integers(5, 12), zero=st.floats(0, TURN), seed=st.integers(0, 99),
       more=st.sampled_from([2, 3, 6, None]))  # fmt: skip
def test_steps_are_told_at_any_zero_and_through_a_rounding(steps, zero, seed, more):
    bits = None if more is None else steps + more
    found = cordic(chip(steps, 300, seed, bits, zero), POLICY, levels(steps).rms)
    assert found is not None
    assert found[0].steps == steps
    assert found[1] < 1e-6


@settings(max_examples=25, deadline=None)
@given(distance=st.floats(1e-3, 3e-2), steps=st.integers(5, 10), count=st.sampled_from([60, 800]))
def test_equal_steps_are_no_cordic(distance, steps, count):
    a = np.random.default_rng(count).uniform(0, TURN, count)
    assert cordic(np.round(a / distance) * distance, POLICY, levels(steps).rms, distance) is None
    # a motor that goes from step to step, read by an encoder that is off by a tenth of one
    near = np.round(a / distance) * distance + 0.1 * distance * np.sin(a)
    assert cordic(near, POLICY, levels(steps).rms) is None


def test_noise_after_the_computation_hides_it():
    a = chip(8, 1000, 1) + np.random.default_rng(2).normal(0, worst_of(8), 1000)
    assert cordic(a, POLICY, levels(8).rms) is None


def recorded(steps=None, bits=14, seed=1, noise=3.5e-4, stated=True):
    """Six runs of an encoder with a distortion of 1 %; noise acts before the chip computes."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(6), 400)
    t = np.tile(np.arange(400) * 2e-3, 6) + run
    a = rng.uniform(0, TURN, 6)[run] + np.array([13.0, -13.0, 40.0, -40.0, 23.0, -23.0])[run] * (t - run)
    true = np.arctan2(np.sin(a + 0.6), np.cos(a + 0.6) + 0.01) + rng.normal(0, noise, len(a))
    angle = true if steps is None else cordic_angle(np.sin(true), np.cos(true), steps)
    columns = {"run": run, "t_s": t, "angle_rad": rounded(angle + 1.2, bits), "angle_ref_rad": a}
    sigma = {"angle_rad": noise, "angle_ref_rad": 1e-6} if stated else {}
    return Log.from_arrays(columns, Noise.given(sigma, tuple(columns)), name="a chip")


def named(found):
    return found.verdict, [e.name for e in found.effects]


def test_a_diagnosis_names_the_steps():
    found = diagnose(recorded(8), "rotary")
    assert named(found) == ("explained", ["cordic_steps"])
    (effect,) = found.effects
    assert effect.link == "electronics"
    assert effect.parameters["steps"].value == 8
    assert effect.p_value < 1e-6
    assert effect.share > 0.95  # what is left is the noise before the chip
    assert "cordic_steps is a fault of the recording" in effect.note
    with pytest.raises(hallsym.InputError, match="let the chip take more steps"):
        hallsym.fit(recorded(8), "rotary", effects=("cordic_steps",))


@pytest.mark.slow
@pytest.mark.parametrize(("steps", "bits", "names"), [
    (6, None, ["cordic_steps"]),
    (10, None, ["cordic_steps"]), (11, 14, ["cordic_steps"]),
    (12, 14, ["cordic_steps"]), (None, 12, ["adc_quantisation"]), (None, 9, ["adc_quantisation"]),
    (None, None, []),
])  # fmt: skip
@pytest.mark.parametrize("stated", [True, False])
def test_a_diagnosis_tells_steps_of_cordic_from_equal_ones(steps, bits, names, stated):
    found = diagnose(recorded(steps, bits, stated=stated), "rotary")
    if names == ["adc_quantisation"] and not stated:
        # equal steps may be part of the noise that is estimated (hallsym.log.estimate)
        assert named(found) in (("explained", names), ("no gap", []))
    else:
        assert named(found) == ("explained" if names else "no gap", names)
    assert all(e.parameters["steps"].value == steps for e in found.effects if e.name == "cordic_steps")


def test_a_simulated_chip_has_so_many_angles():
    noise, campaign = hallsym.NoiseModel({}, cordic_steps=6), read_campaign(CAMPAIGN)
    chip_only = hallsym.build("rotary", meta=Meta(probes=[{"channel": "angle_rad"}]))
    angles = hallsym.simulate(chip_only, {}, campaign, noise, seed=1)["angle_rad"]
    assert len(np.unique(np.round(angles, 9))) == 2 * len(levels(6).angles)
    with pytest.raises(hallsym.InputError, match="Steps of CORDIC belong to a decoded angle"):
        hallsym.simulate(hallsym.build("rotary"), {}, campaign, noise, seed=1)
    with pytest.raises(hallsym.InputError, match="whole number from 0 to 32"):
        hallsym.NoiseModel({}, cordic_steps=33)


def test_a_campaign_states_the_noise_of_both_forms_or_says_what_lacks(tmp_path, capsys):
    machine, log = tmp_path / "angle.toml", tmp_path / "angle.csv"
    machine.write_text('[[probes]]\nchannel = "angle_rad"\n')
    bundled = CAMPAIGN.read_text(encoding="utf-8")
    own = tmp_path / "campaign.toml"
    own.write_text("".join(line for line in bundled.splitlines(True) if not line.startswith("angle_rad = 3")))
    assert main(["simulate", str(own), "--machine", str(machine), "-o", str(log), "--seed", "1"]) == 2
    assert "states v_sin_v and v_cos_v, but this machine is read as angle_rad" in capsys.readouterr().err
    for model in ("rotary", "rotary_meng"):
        words = ["simulate", str(CAMPAIGN), "--model", model, "--seed", "1"]
        assert main([*words, "--machine", str(machine), "-o", str(log)]) == 0
        assert "angle_rad" in hallsym.read_log(str(log)).columns
        assert main([*words, "-o", str(log)]) == 0
        assert "v_sin_v" in hallsym.read_log(str(log)).columns
