"""Where a gap lies: named where it is put, shares add up, silent on noise of any colour and tails."""

import json
from dataclasses import asdict
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from gap_twins import listed, machine, unlisted
from twins import SIGMAS, record

import hallsym
from hallsym.diagnosis import POLICY, Base
from hallsym.diagnosis.curves import Coordinate, FineMap, Smooth, run_gains
from hallsym.diagnosis.localisation import Located, located, shape
from hallsym.diagnosis.report import unexplained
from hallsym.diagnosis.residual_table import ResidualTable, spectrum
from hallsym.diagnosis.residuals import Piece
from hallsym.diagnosis.setup import base_of
from hallsym.log import Log, Noise, Sigma

HELD = tuple(range(2, 57, 5))


def base_on(log: Log, model: str = "stage31") -> Base:
    held = log.meta.holdout or HELD
    return base_of(log, hallsym.fit(log, model, solver="direct", holdout=held, accept=["all"]))


@cache
def found(name: str, campaign: str, kind=listed) -> Located:
    effect = kind(np.random.default_rng(1))[name]
    log = machine(campaign, (effect,), seed=1, temperature="temperature" in name)
    return located(base_on(log), log.runs)


@pytest.mark.parametrize(
    ("name", "campaign", "by"),
    [
        ("height_quadratic", "grid", "height Z"),
        pytest.param("gain_temperature_drift", "multisine", "temperature", marks=pytest.mark.slow),
        ("hysteresis", "multisine", "direction of motion"),
        pytest.param("time_skew", "grid", "velocity", marks=pytest.mark.slow),
        ("odd_nonlinearity", "raster", "the reading itself"),
        pytest.param("motor_stray_field", "multisine", "acceleration", marks=pytest.mark.slow),
        pytest.param("gain_time_drift", "grid", "time in the campaign", marks=pytest.mark.slow),
    ],
)
def test_the_first_statement_is_the_physical_one(name: str, campaign: str, by: str) -> None:
    here = found(name, campaign)
    first, *_ = here.statements
    assert first.by == by
    assert first.p_value < 0.01
    assert first.share > 0.5
    told = here.statements[: len(here.curves)]
    assert sum(s.share for s in told) <= 1 + 1e-12
    assert len({s.by for s in told}) == len(told)
    assert all(0 <= s.share <= 1 and 0 <= s.p_value <= 0.05 for s in here.statements)


def test_hum_is_said_to_lie_at_the_mains() -> None:
    (first, *_) = found("mains_hum", "raster").statements
    assert (first.by, first.at) == ("frequency", "the mains, 60 Hz")
    assert first.share == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(("line", "near"), [(50.15, True), (59.85, True), (50.6, False), (55.0, False)])
def test_the_mains_are_what_a_grid_lets_them_drift_by(line: float, near: bool) -> None:
    t = np.arange(0, 60, 2e-3)
    row = np.sin(2 * np.pi * line * t)[None]
    found = spectrum([Piece(0, t, row, row, row, row, np.ones(len(t), bool), {})])
    power = {band: runs[0][0] for band, runs in found.items()}
    mains = sum(v for band, v in power.items() if band.mains)
    assert mains / sum(power.values()) == pytest.approx(float(near), abs=0.05)


@pytest.mark.slow
def test_gains_that_follow_nothing_logged_are_the_runs_own() -> None:
    first, *_ = found("run_gain", "grid", unlisted).statements
    assert (first.by, first.at) == ("run", "gain of its own")


def test_what_was_fitted_on_some_runs_holds_on_the_others() -> None:
    first, *_ = found("time_skew", "grid").statements
    assert first.held_out == pytest.approx(first.share, abs=0.1)


def test_gain_against_the_vertical_state_where_the_model_has_none() -> None:
    log = Log.from_arrays(record(seed=4, samples=50), noise=stated(1.0))
    first, *_ = located(base_on(log, "stage30"), log.runs).statements
    assert first.by == "height Z and tilts Rx, Ry"
    assert "(the gain: Z" in first.text
    assert first.share > 0.9


# -- noise ---------------------------------------------------------------------------------------------------


def stated(part: float) -> Noise:
    return Noise({c: Sigma(part * s, "given") for c, s in SIGMAS.items()})


NOISES = {"white": {}, "correlated": {"correlation_s": 0.1}, "heavy": {"degrees_of_freedom": 4.0}}


LEAST = 1 / 2000
"""Least p-value of 1999 random signs."""


def p_of(statistic: np.ndarray) -> float:
    return float((statistic >= statistic[0]).mean())


# -- the pieces ----------------------------------------------------------------------------------------------


def made_up(
    residual: np.ndarray, x: np.ndarray, runs: int = 30, channels: tuple[str, ...] = ("m_m",)
) -> ResidualTable:
    """A residual table of one sensor with the coordinate `x` under the name of Z; unit noise."""
    n = residual.shape[1]
    run = np.arange(n) * runs // n
    sensed = np.random.default_rng(9).uniform(-1, 1, (1, n))
    base = SimpleNamespace(
        model=SimpleNamespace(channels=channels, references=("x_ref_m",)), covariance=np.eye(1), sigma={},
        pose_weights=np.ones(1), policy=POLICY, timed=True, sliced=False,
    )  # fmt: skip
    return ResidualTable(
        base, run, residual, sensed, np.zeros((1, n)), {"z_m": x}, np.ones((1, 1, n)), run, run,
        np.arange(n) * 4 * runs // n,
    )  # fmt: skip


Z = Coordinate("height Z", "z_m", "m")


def test_a_smooth_curve_is_found_with_a_band_that_holds_it() -> None:
    rng = np.random.default_rng(2)
    x = rng.uniform(-1, 1, 30_000)
    truth = np.cos(2 * x)
    r = made_up((truth + rng.standard_normal(30_000))[None], x)
    curve = Smooth(r, Z, Z.values(r)).curve(r.residual)
    assert curve is not None
    assert curve.p_value == LEAST
    assert curve.explained == pytest.approx((truth**2).sum(), rel=0.05)
    data = shape(curve)
    band = data.readings["m_m"]
    assert data.value_unit == "m"
    of_encoder = made_up(r.residual, x, channels=("v_sin_v",))
    assert shape(Smooth(of_encoder, Z, Z.values(of_encoder)).curve(r.residual)).value_unit == "v"
    inside = np.abs(np.array(data.grid)) < 0.95
    value, low, high = (np.array(v)[inside] for v in (band.value, band.low, band.high))
    expected = np.cos(2 * np.array(data.grid))[inside]
    assert np.abs(value - expected).max() < 0.15
    assert (low < value).all()
    assert (value < high).all()


@pytest.mark.parametrize(
    ("truth", "size", "least"),
    [
        pytest.param(lambda x: np.cos(9 * x), 3000, 0.9, id="free knots"),
        pytest.param(lambda x: 0.3 * np.cos(2 * x), 1500, 0.83, id="one bend"),
        pytest.param(lambda x: 0.3 * x, 1500, 0.7, id="a line"),
    ],
)
def test_a_curve_bends_as_stiffly_as_predicts_other_runs_best(truth, size: int, least: float) -> None:
    explained = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1, 1, size)
        r = made_up((truth(x) + rng.standard_normal(size))[None], x)
        explained.append(Smooth(r, Z, Z.values(r)).curve(r.residual).explained / (truth(x) ** 2).sum())
    assert np.mean(explained) > least


def test_the_shape_of_what_is_left_is_plain_data() -> None:
    here = found("bump", "raster", unlisted)
    data = json.loads(json.dumps(asdict(unexplained(here, 0.6)), allow_nan=False))
    assert data["share"] == 0.6
    assert data["curve"]["coordinate"] == "the reading itself"
    assert data["curve"]["column"] == "reading_m"
    for channel in ("hall_a_m", "hall_b_m", "hall_c_m"):
        curve = data["curve"]["readings"][channel]
        assert len(curve["value"]) == len(curve["low"]) == len(data["curve"]["grid"])
    rng = np.random.default_rng(1)
    place = rng.uniform(-1e-4, 1e-4)
    peak = data["curve"]["grid"][int(np.argmax(data["curve"]["readings"]["hall_c_m"]["value"]))]
    assert abs(peak - place) < 5e-5  # the bump is 20 to 50 um wide
    assert unexplained(Located((), ()), 0.3).curve is None


def test_a_gain_of_every_run_is_told_from_noise() -> None:
    rng = np.random.default_rng(3)
    noise = rng.standard_normal((1, 12_000))
    r = made_up(noise, rng.uniform(-1, 1, 12_000))
    gains = rng.standard_normal(30)[r.run]
    assert p_of(run_gains(r, noise)[1]) > 0.01
    explained, statistic, foreseen = run_gains(r, noise + gains * r.sensed)
    assert p_of(statistic) == LEAST
    assert explained == pytest.approx(float(((gains * r.sensed) ** 2).sum()), rel=0.1)
    assert r.metric(noise + gains * r.sensed - foreseen) < 1.05 * r.metric(noise)


@pytest.mark.parametrize("make", [pytest.param(Smooth, marks=pytest.mark.slow), FineMap])
def test_p_values_of_noise_are_spread_evenly(make) -> None:
    """Blocks with noise of very different size and with memory: never smaller than they should be.

    Bounds are 3.5 standard deviations of a share of 300, and twice that at 0.01, where the distribution over
    the signs is only matched in three moments. Two bases are tried and counted: p-values may be too large.
    """
    rng = np.random.default_rng(4)
    x = rng.uniform(-1, 1, 1200)
    p = []
    for _ in range(300):
        slow = np.repeat(rng.standard_normal(240), 5) * rng.choice([0.3, 1.0, 4.0], 30).repeat(40)
        r = made_up(slow[None], x)
        p.append(make(r, Z, Z.values(r)).curve(r.residual).p_value)
    assert 0.15 < np.mean(np.array(p) < 0.5) < 0.6
    assert np.mean(np.array(p) < 0.1) < 0.16
    assert np.mean(np.array(p) < 0.01) < 0.04
