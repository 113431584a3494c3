"""The budget of a decoded position against the paper's matrices typed in numpy, and against itself."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st
from twins import HALL, SIGMAS, phi, pm, record, true_model, white, with_arrays, with_noise

from hallsym.errors import InputError
from hallsym.estimation import Fit, fit
from hallsym.uncertainty import Settings, notes, over_log, position_budget, uncertainty_map
from hallsym.uncertainty.inputs import slopes

POSE, STATE = ("x_m", "y_m", "rz_rad"), ("z_m", "rx_rad", "ry_rad")
SOMEWHERE = {"x_m": 2e-4, "y_m": -3e-4, "rz_rad": 1e-4, "z_m": 2e-4, "rx_rad": -3e-4, "ry_rad": 1e-4}
ELSEWHERE = {"x_m": 1e-4, "y_m": 2e-4, "rz_rad": -1e-4, "z_m": -1e-4, "rx_rad": 2e-4, "ry_rad": -1e-4}
EVERYTHING = Settings(
    averaged=2,
    adc_step=60e-9,
    zero_averaged=50,
    zero_at=ELSEWHERE,
    state_std=dict.fromkeys(STATE, 1e-7),
    scale_std=dict.fromkeys(POSE, 3e-6),
)


@cache
def fitted(name: str = "stage31", *effects: str) -> Fit:
    return fit(
        with_noise(record(seed=1)), name, effects=effects, solver="direct", loss="none", accept=["all"]
    )


def columns(at: dict[str, float]) -> tuple[np.ndarray, np.ndarray]:
    return np.array([at[c] for c in POSE]), np.array([at[c] for c in STATE])


# -- slopes ----------------------------------------------------------------------------------------------


def paper_position(values, m, s, m0, s0, q0):
    """Eq. (31) with zeros from a reset: m0 = phi(s0) (PM q0 + d), q = PM^-1 (m / phi(s) - d)."""
    d = m0 / phi(values, s0) - pm(values) @ q0
    return np.linalg.solve(pm(values), m / phi(values, s) - d)


def test_slopes_are_those_of_the_papers_equation_with_a_reset():
    """Central differences of an independent numpy model; the step's error is 1e-6 of a slope or less."""
    known = fitted()
    (q, s), (q0, s0) = columns(SOMEWHERE), columns(ELSEWHERE)
    values = dict(zip(known.model.names, known.values, strict=True))
    m, m0 = (phi(values, state) * (pm(values) @ pose) for state, pose in ((s, q), (s0, q0)))
    given_ = {"reading": m, "state": s, "zero reading": m0, "zero state": s0, "zero pose": q0}
    assert np.allclose(paper_position(values, *given_.values()), q, rtol=0, atol=1e-15)
    found = slopes(known, q[:, None], s[:, None], EVERYTHING)
    for place, at in given_.items():
        for k in range(3):
            step = 1e-7 * np.eye(3)[k]
            up, down = (
                paper_position(values, *{**given_, place: at + sign * step}.values()) for sign in (1, -1)
            )
            assert np.allclose(found.places[place][0, :, k], (up - down) / 2e-7, rtol=1e-5, atol=1e-8), place
    for k, name in enumerate(known.model.names):
        step = 1e-5 * max(abs(values[name]), 0.1)
        up, down = (
            paper_position({**values, name: values[name] + sign * step}, *given_.values()) for sign in (1, -1)
        )
        assert np.allclose(found.parameters[0, :, k], (up - down) / (2 * step), rtol=1e-5, atol=1e-10), name


def test_the_scale_of_the_reference_counts_from_the_zeroing():
    found = position_budget(fitted(), SOMEWHERE, EVERYTHING)["x_m"]
    (scale,) = (s for s in found.sources if s.name == "reference scale x")
    assert scale.contribution == pytest.approx(3e-6 * 1e-4, rel=1e-12)  # 200 um - 100 um


# -- sums ------------------------------------------------------------------------------------------------


@effort(max_examples=15, deadline=None)
@given(st.integers(1, 1000), st.integers(1, 1000), st.floats(0.1, 10.0))
def test_noise_averages_and_steps_do_not(averaged, zeroed, scale):
    settings = replace(EVERYTHING, averaged=averaged, zero_averaged=zeroed, adc_step=scale * 60e-9)
    for one, many in zip(
        position_budget(fitted(), SOMEWHERE, replace(EVERYTHING, averaged=1, zero_averaged=1)).values(),
        position_budget(fitted(), SOMEWHERE, settings).values(),
        strict=True,
    ):
        for a, b in zip(one.sources, many.sources, strict=True):
            n = zeroed if a.name.startswith("zeroing") else averaged
            averages = a.name.endswith("noise") or a.name.startswith("zeroing: pose")
            factor = n**-0.5 if averages else scale if "ADC" in a.name else 1.0
            assert abs(b.contribution) == pytest.approx(factor * abs(a.contribution), rel=1e-9)


# -- many positions --------------------------------------------------------------------------------------


@pytest.mark.parametrize("level", [None, 0.99])
def test_a_map_holds_the_budgets_of_its_points(level):
    settings = replace(EVERYTHING, level=level)
    known = with_arrays(fitted(), degrees_of_freedom=np.linspace(3.0, 8.0, len(fitted().values)))
    fixed = {"rz_rad": 1e-4, "rx_rad": 2e-4}
    axes = {"x_m": [-3e-4, 0.0, 2e-4], "y_m": [1e-4, 4e-4], "z_m": [-2e-4, 0.0, 2.5e-4]}
    found = uncertainty_map(known, {**axes, "y_m": [1e-4, 2e-4, 4e-4]}, settings, fixed=fixed)
    assert found.expanded.shape == (3, 3, 3, 3)
    at = {**fixed, "x_m": 2e-4, "y_m": 1e-4, "z_m": -2e-4}
    for i, budget in enumerate(position_budget(known, at, settings).values()):
        assert found.expanded[i, 2, 0, 0] == pytest.approx(budget.expanded, rel=1e-9)
    where, worst = (of["y_m"] for of in (found.recorded.where, found.recorded.worst))
    assert worst == found.expanded[1].max()
    assert position_budget(known, where, settings)["y_m"].expanded == pytest.approx(worst, rel=1e-9)


def test_over_a_log_is_the_budget_of_every_sample():
    data = {c: v[::97] for c, v in record(seed=1).items()}
    short = with_noise(data)
    found = over_log(fitted(), short, EVERYTHING)
    names = dict(zip(("x_ref_m", "y_ref_m", "rz_ref_rad", *STATE), (*POSE, *STATE), strict=True))
    rows = [{ours: float(data[c][k]) for c, ours in names.items()} for k in range(len(data["run"]))]
    U = np.array([[b.expanded for b in position_budget(fitted(), at, EVERYTHING).values()] for at in rows])
    assert found.samples == len(rows)
    assert list(found.rms.values()) == pytest.approx(np.sqrt(np.mean(U**2, axis=0)), rel=1e-9)
    assert list(found.worst.values()) == pytest.approx(U.max(axis=0), rel=1e-9)
    assert found.where["x_m"] == pytest.approx(rows[int(U[:, 0].argmax())])
    assert found.span["z_m"] == (data["z_m"].min(), data["z_m"].max())
    assert found.outside({"x_m": 0.0, "z_m": 1e-3}) == ["z_m"]


# -- refused and told ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "at", "words"),
    [
        ({"covariance": np.zeros((21, 21))}, {}, "no determined parameter"),
        ({}, {"z_m": 5e-3}, "The gain of hall_b_m at z_m = 0.005.* crosses zero"),
        ({}, {"z_um": 5}, "must be given in columns"),
        ({}, {"x_m": float("inf")}, "finite number"),
    ],
)
def test_what_has_no_budget(change, at, words):
    known = with_arrays(fitted(), **change)
    with pytest.raises(InputError, match=words) as caught:
        position_budget(known, at)
    assert str(caught.value).count(". ") == 0


def test_notes_say_what_the_budget_does_not_hold():
    known = with_arrays(fitted(), at_bound=np.array(fitted().model.names) == "eta_B").changed(
        undetermined_by_log=("a_A",),
        goodness=replace(fitted().goodness, cost_per_degree_of_freedom=4.0, residual_over_noise=2.0),
    )
    said = " ".join(notes(known, Settings()))
    for word in ("a_A", "eta_B", "residual error is 2 times the noise floor", "from 1 reading"):
        assert word in said
    assert notes(fitted(), Settings(zero_averaged=100)) == []


# -- against recalibrations ------------------------------------------------------------------------------


@pytest.mark.slow
def test_recalibrated_machines_scatter_as_stated():
    """Fit 200 simulated campaigns; each time zero, read with noise, decode; the error has the stated u.

    The variance ratio of 200 samples lies within 0.70 and 1.36 for 99.9 % of all such experiments (chi2).
    """
    from scipy.stats import chi2

    n, model = 200, true_model()
    truth = model.nominal
    settings = Settings(averaged=4, zero_averaged=20, zero_pose_std=dict.fromkeys(POSE, 5e-8), zero_at={})
    (q, s), values = columns(SOMEWHERE), dict(zip(model.names, truth, strict=True))
    m_true, errors, stated = phi(values, s) * (pm(values) @ q), [], []
    fits_only, fit_stated = [], []
    for seed in range(n):
        rng = np.random.default_rng(10_000 + seed)
        known = fit(with_noise(white(seed)), model, solver="direct", loss="none")
        found = dict(zip(model.names, known.values, strict=True))
        hall, vertical = np.array([SIGMAS[c] for c in HALL]), np.array([SIGMAS[c] for c in STATE])
        m = m_true + rng.normal(0, hall / 2)
        m0 = rng.normal(0, hall / np.sqrt(20))
        state, s0 = s + rng.normal(0, vertical / 2), rng.normal(0, vertical / np.sqrt(20))
        q0 = rng.normal(0, 5e-8, 3)  # the zeroing is believed to be at 0 and is at -q0
        errors.append(paper_position(found, m, state, m0, s0, q0) - q)
        fits_only.append(paper_position(found, m_true, s, np.zeros(3), np.zeros(3), np.zeros(3)) - q)
        budgets = position_budget(known, SOMEWHERE, settings).values()
        stated.append([b.std for b in budgets])
        fit_stated.append([b.sources[0].std for b in budgets])
    low, high = chi2.ppf([0.0005, 0.9995], n) / n
    for what, said in ((errors, stated), (fits_only, fit_stated)):
        ratio = np.mean(np.square(what), axis=0) / np.mean(np.square(said), axis=0)
        assert np.all((low < ratio) & (ratio < high)), ratio
