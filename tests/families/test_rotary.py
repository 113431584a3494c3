"""Rotary encoders: physics by independent facts.

Equivalences: readings equal numpy's cos, sin and arctan2; decoding inverts reading for any angle; Table 1 of
Sensors 2014, 14, 13980 from closed forms; ranks follow from the scale of an arctangent; estimates scatter as
an information matrix made of finite differences of numpy's arctan2 says; a table of situations comes back.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import hallsym
from hallsym.estimation.covariance import uncertainty
from hallsym.estimation.factors import summarise
from hallsym.estimation.likelihood import cost_of
from hallsym.estimation.optimum import refit
from hallsym.families.published import table
from hallsym.families.rotary import FAMILY
from hallsym.families.rotary import models as family
from hallsym.log import Log

TURN = 2 * np.pi
ANGLE = family.angle_only()
SITUATIONS = "abcd"


def truth(situation: str) -> dict[str, float]:
    columns = table("table2_parameters")
    return dict(zip(columns["parameter"], columns[situation], strict=True))


def plates(v: dict[str, float], a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator of the paper's model, in numpy."""
    u = a + v.get("zero", 0.0)
    m = v.get("m", 0.1)
    k1 = v.get("K1", family.K1) if "m" in v else 0.0

    def f(x: np.ndarray) -> np.ndarray:
        return k1 * m**2 * np.cos(x) ** 2 + family.K2 * m * np.cos(x)

    beta = v.get("beta", 0.0)
    y = v.get("Vy", 0.0) + v.get("Ay", 1.0) * f(u - np.pi / 2 + beta)
    return y, v.get("Vx", 0.0) + v.get("Ax", 1.0) * f(u)


def decoded_angle(v: dict[str, float], a: np.ndarray) -> np.ndarray:
    return np.arctan2(*plates(v, a))


def wrap(x: np.ndarray) -> np.ndarray:
    return np.angle(np.exp(1j * np.asarray(x)))


def reading(model, v: dict[str, float], a: np.ndarray) -> np.ndarray:
    p = model.vector({n: x for n, x in v.items() if n in model.names})
    return np.array(model.reading(p, [], np.atleast_2d(a), np.zeros((0, len(a))))).reshape(-1, len(a))


def angle_log(v: dict[str, float], a: np.ndarray, sigma: float = 0.0, seed: int = 0, **columns) -> Log:
    noise = sigma * np.random.default_rng(seed).standard_normal(len(a))
    return Log.from_arrays(
        {"angle_ref_rad": a, "angle_rad": np.mod(decoded_angle(v, a) + noise, TURN), **columns}
    )


def voltage_log(v: dict[str, float], a: np.ndarray, sigma: float = 0.0, seed: int = 0, **columns) -> Log:
    rng = np.random.default_rng(seed)
    y, x = (part + sigma * rng.standard_normal(len(a)) for part in plates(v, a))
    return Log.from_arrays({"angle_ref_rad": a, "v_sin_v": y, "v_cos_v": x, **columns})


# -- Table 1 ---------------------------------------------------------------------------------------------


def largest_error_deg(v: dict[str, float]) -> float:
    a = np.linspace(-np.pi, np.pi, 20_001)
    model = family.rotary_meng(ANGLE).with_parameters({"K1": {"lower": 0.0}})
    found = reading(model, {"K1": 0.0, **v}, a)[0]
    return float(np.degrees(np.abs(wrap(found - a)).max()))


@pytest.mark.parametrize(
    ("values", "printed"),
    [
        ({"Vx": 1e-3, "Vy": 1e-3}, 0.081028),
        ({"Ay": 1.003}, 0.085815),
        ({"beta": np.radians(0.1)}, 0.1000),
    ],
)
def test_single_factors_of_table_1(values, printed):
    assert largest_error_deg(values) == pytest.approx(printed, abs=1e-6)


def test_non_linearity_of_table_1_needs_this_ratio():
    assert pytest.approx(1.896e-3, rel=1e-9) == family.K1 * 0.1 / family.K2
    assert largest_error_deg({"K1": family.K1}) == pytest.approx(0.07682, abs=5e-6)


# -- readings --------------------------------------------------------------------------------------------

FEW = st.floats(-0.01, 0.01)
VALUES = st.fixed_dictionaries(
    {"Vx": FEW, "Vy": FEW, "beta": FEW, "Ax": st.floats(0.99, 1.01), "Ay": st.floats(0.99, 1.01),
     "m": st.floats(0.05, 0.15), "zero": st.floats(-np.pi, np.pi)}
)  # fmt: skip
ANGLES = np.linspace(-7.0, 20.0, 97)


@settings(max_examples=30, deadline=None)
@given(VALUES)
def test_readings_are_the_papers_formula(v):
    y, x = plates(v, ANGLES)
    voltages = reading(family.rotary_meng(), v, ANGLES)
    assert np.allclose(voltages, [y, x], rtol=0, atol=1e-13)
    angle = reading(family.rotary_meng(ANGLE), v, ANGLES)[0]
    assert np.abs(wrap(angle - np.arctan2(y, x))).max() < 2e-11  # distortions up to 4 %: w^7 / 7
    assert np.abs(angle - ANGLES - v["zero"]).max() < 0.1  # and follows every turn


@settings(max_examples=20, deadline=None)
@given(VALUES, st.sampled_from(FAMILY.models), st.sampled_from([None, ANGLE]), st.booleans())
def test_decoding_inverts_reading(v, make, layout, more):
    model = family.harmonics(make(layout)) if more else make(layout)
    v = v | ({"h4c": 2e-3, "h3s": -1e-3, "h8s": 1e-3} if more else {})
    p = model.vector({n: x for n, x in v.items() if n in model.names})
    m, weight = reading(model, v, ANGLES), np.ones(len(model.channels))
    back = [float(model.decoded(p, [], m[:, k], [], weight)) for k in range(len(ANGLES))]
    assert np.abs(wrap(back - ANGLES)).max() < 1e-9


def test_harmonics_are_the_same_error_in_both_forms():
    v, a = {"h3c": 1e-3, "h5s": -2e-3, "h8c": 5e-4}, np.linspace(0, TURN, 50)
    y, x = reading(family.harmonics(family.rotary()), v, a)
    angle = reading(family.harmonics(family.rotary(ANGLE)), v, a)[0]
    assert np.abs(wrap(np.arctan2(y, x) - angle)).max() < 1e-8  # third order of 3 mrad
    assert np.allclose(angle - a, 1e-3 * np.cos(3 * a) - 2e-3 * np.sin(5 * a) + 5e-4 * np.cos(8 * a))


# -- what is determined ----------------------------------------------------------------------------------
BACK_AND_FORTH = np.r_[np.linspace(0, 2 * TURN, 360), np.linspace(2 * TURN, 0, 360)]


def ellipse_log(seed, sigma, reference, cover=TURN, rest=0):
    """A turn forward and a turn back in two voltages beside a noisy reference, 400 samples each."""
    rng, v, rows = np.random.default_rng(seed), {**truth("a"), "zero": 0.6}, []
    for run, sign in enumerate((1, -1)):
        a = np.concatenate([np.full(rest, 0.3), sign * cover * np.arange(400) / 400])
        y = v["Vy"] + v["Ay"] * np.sin(a + v["zero"] + v["beta"]) + sigma * rng.standard_normal(len(a))
        x = v["Vx"] + v["Ax"] * np.cos(a + v["zero"]) + sigma * rng.standard_normal(len(a))
        rows.append((np.full(len(a), run), y, x, a + reference * rng.standard_normal(len(a))))
    names = ("run", "v_sin_v", "v_cos_v", "angle_ref_rad")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    stated = {"v_sin_v": sigma, "v_cos_v": sigma, "angle_ref_rad": reference}
    return hallsym.Log.from_arrays(columns, hallsym.Noise.given(stated, names)), v


@pytest.mark.parametrize(("sigma", "reference"), [(1e-4, 5e-3), (1e-3, 1e-3), (1e-3, 1e-5)])
def test_noise_of_the_reference_is_tangential(sigma, reference):
    """Of an ideal encoder: the zero has the noise along the circle, the amplitude that across it."""
    fit = hallsym.fit(ellipse_log(1, sigma, reference)[0], "rotary_ideal", solver="direct", loss="none")
    found = uncertainty(fit.likelihood.at(fit.values), fit.determination)  # for white noise
    std = dict(zip(fit.model.names, found.covariance.diagonal() ** 0.5, strict=True))
    scale = np.sqrt(max(found.goodness.cost_per_degree_of_freedom, 1.0)) if "scaled" in found.method else 1.0
    assert std["zero"] == pytest.approx(scale * np.hypot(sigma, reference) / np.sqrt(800), rel=0.03)
    assert std["A"] == pytest.approx(scale * sigma / np.sqrt(800), rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize(("sigma", "reference", "more"), [
    (1e-4, 5e-3, {}), (1e-3, 1e-3, {}), (1e-4, 5e-3, {"cover": 4.6}), (1e-4, 5e-3, {"rest": 400}),
])  # fmt: skip
def test_stated_uncertainties_hold_beside_a_noisy_reference(sigma, reference, more):
    pulls = []
    for seed in range(100):
        log, v = ellipse_log(seed, sigma, reference, **more)
        fit = hallsym.fit(log, "rotary", solver="direct", loss="none")
        pulls.append((fit.values - [v[n] for n in fit.model.names]) / fit.std)
    rms = np.sqrt(np.mean(np.square(pulls), axis=0))
    # chi-square of 100 lies within 0.72 to 1.29 squared with 99.9 %, six times asked
    assert rms == pytest.approx(np.ones(6), abs=0.28)


@pytest.mark.parametrize(("k1", "rank"), [(family.K1, 5), (0.0, 4)])
def test_the_angle_leaves_the_common_scale_open(k1, rank):
    v = truth("a") | {"K1": k1}
    fixed = {"zero": {"fixed": True}, "K1": {"nominal": k1, "lower": k1, "upper": k1}}
    fit = hallsym.fit(angle_log(v, BACK_AND_FORTH, 1e-4), "rotary_meng", parameters=fixed, solver="direct")
    free = [n for n, p in zip(fit.model.names, fit.model.parameters, strict=True) if p.width > 0]
    assert free == ["Vx", "Vy", "Ax", "Ay", "beta", "m"]
    assert len(free) - fit.determination.n_structural == rank
    assert set(fit.structural) == {"Vx", "Vy", "Ax", "Ay"} | ({"m"} if k1 == 0 else set())
    assert not fit.undetermined_by_log
    known = {c.expression for c in fit.combinations}
    assert {"Vx/(Ax*K2*m)", "Vy/(Ay*K2*m)", "Ay/Ax"} <= known


@pytest.mark.parametrize(
    ("make", "situation"),
    [
        (angle_log, "b"),
        (voltage_log, "a"),
        *(pytest.param(voltage_log, s, marks=pytest.mark.slow) for s in SITUATIONS if s != "a"),
    ],
)
def test_noise_free_logs_give_identifiable_combinations_exactly(make, situation):
    v = truth(situation) | {"zero": 3.1}
    fit = hallsym.fit(make(v, BACK_AND_FORTH), "rotary_meng", solver="direct", loss="none")
    p = dict(zip(fit.model.names, fit.values, strict=True))
    for a, b in (("Vx", "Ax"), ("Vy", "Ay"), ("Ay", "Ax")):
        assert p[a] / p[b] == pytest.approx(v[a] / v[b], rel=1e-9)
    for name in ("beta", "m", "zero"):
        assert p[name] == pytest.approx(v[name], rel=1e-9)


def combos(v: dict[str, float]) -> np.ndarray:
    scale = family.K2 * v["m"]
    offsets = (v["Vx"] / v["Ax"] / scale, v["Vy"] / v["Ay"] / scale)
    return np.array([*offsets, v["Ay"] / v["Ax"], v["beta"], v["m"], v["zero"]])


def from_combos(c: np.ndarray) -> dict[str, float]:
    scale = family.K2 * c[4]
    return {
        "Vx": c[0] * scale,
        "Vy": c[1] * c[2] * scale,
        "Ax": 1.0,
        "Ay": c[2],
        "beta": c[3],
        "m": c[4],
        "zero": c[5],
    }


def cramer_rao(v: dict[str, float], a: np.ndarray, sigma: float) -> np.ndarray:
    """Least standard deviation of the combinations, from finite differences of numpy's arctan2."""
    c, J = combos(v), []
    for k in range(len(c)):
        step = np.zeros(len(c))
        step[k] = 1e-5
        up, down = (decoded_angle(from_combos(c + s * step), a) for s in (1, -1))
        J.append(wrap(up - down) / 2e-5)
    return sigma * np.sqrt(np.diag(np.linalg.inv(np.array(J) @ np.transpose(J))))


def test_estimates_scatter_as_cramer_rao_allows():
    v, sigma = truth("d") | {"zero": -2.0}, np.radians(0.02)
    a = np.linspace(0, TURN, 360, endpoint=False)
    log = angle_log(v, a, sigma)
    fit = hallsym.fit(log, "rotary_meng", solver="direct")
    found = []
    for seed in range(100):
        again = angle_log(v, a, sigma, seed)
        cost = cost_of(summarise(again, fit.model), {"angle_rad": sigma})
        p = refit(cost, fit.values, [fit.model.names.index(n) for n in fit.fixed])
        found.append(combos(dict(zip(fit.model.names, p, strict=True))))
    bound = cramer_rao(v, a, sigma)
    scatter = np.sqrt(np.mean((np.array(found) - combos(v)) ** 2, axis=0))
    assert np.all(scatter < 1.3 * bound)
    assert np.all(scatter > 0.8 * bound)
    stated = {c.expression: c.std for c in fit.combinations}
    assert stated["Ay/Ax"] == pytest.approx(bound[2], rel=0.15)
