"""The cost on summaries is the sum over samples, and its derivatives are its derivatives.

Brute force, typed from the model: r = m - phi (PM q + d) at each sample, C of a run = reading variance plus
the mean over its samples of (dr/dcolumn)^2 times column variance, F = sum r^T C^-1 r, smallest over d.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import COLUMNS, HALL, SIGMAS, cost_on, phi, pm, record, true_model, with_noise

from hallsym.estimation.factors import summarise, summarise_at
from hallsym.estimation.likelihood import cost_of
from hallsym.families import build
from hallsym.log import Log

NAMES = ["stage15", "stage30", "stage31"]
DERIVED = [
    ("stage15", ()),
    ("stage30", ()),
    ("stage31", ()),
    ("stage31_tied", ()),
    ("stage31", ("exact_rotation",)),
]
NOISY = {**SIGMAS, "z_m": 2e-6, "rx_rad": 3e-6, "ry_rad": 4e-6}
"""State noise large enough to matter in C."""
seeds = st.integers(0, 2**32 - 1)


@pytest.fixture(scope="module")
def log() -> Log:
    return with_noise(record(seed=6, samples=20))


def near(model, seed: int, share: float = 0.02) -> np.ndarray:
    """A point some way from the truth: `share` of the width of the bounds, Table 5's widths cut to 100."""
    width = np.minimum(model.bounds[1] - model.bounds[0], 100.0)
    return model.nominal + share * width * np.random.default_rng(seed).uniform(-1, 1, len(width))


def brute_force(
    log: Log, model, p: np.ndarray, centre: np.ndarray, sigma, offsets=None
) -> tuple[float, dict]:
    """F and the offsets of each run, sample by sample, without a line of the package."""
    v = model.named(p)
    PM, total, best = pm(v), 0.0, {}
    slope = np.array([[v.get(f"{q}_{k}", 0.0) for q in "abc"] for k in "ABC"])
    for run in log.runs:
        data = log.run(run)
        q, s = np.array([data[c] for c in COLUMNS[:3]]), np.array([data[c] for c in COLUMNS[3:]])
        gain, moved = phi(v, s), PM @ q
        residual = np.array([data[c] for c in HALL]) - gain * moved
        C = np.diag([sigma[c] ** 2 for c in HALL])
        n = q.shape[1]
        for t in range(n):
            J = np.hstack([gain[:, t : t + 1] * PM, (moved[:, t] - PM @ centre[:3])[:, None] * slope])
            C = C + (J * [sigma[c] ** 2 for c in COLUMNS]) @ J.T / n
        W = np.linalg.inv(C)
        if not model.offsets:
            d = np.zeros(3)
        elif offsets is not None:
            d = offsets[run]
        else:  # r = residual - diag(gain) d: normal equations of the three offsets
            normal = sum(np.diag(gain[:, t]) @ W @ np.diag(gain[:, t]) for t in range(n))
            right = sum(np.diag(gain[:, t]) @ W @ residual[:, t] for t in range(n))
            d = np.linalg.solve(normal, right)
        best[run] = d
        r = residual - gain * d[:, None]
        total += sum(r[:, t] @ W @ r[:, t] for t in range(n))
    return total, best


@settings(max_examples=4)
@given(seeds)
@pytest.mark.parametrize("name", NAMES)
def test_cost_is_the_sum_over_samples(log, name, seed):
    model = true_model(name)
    cost = cost_on(log, model, NOISY)
    p = near(model, seed)
    expected, offsets = brute_force(log, model, p, cost.summary.centre, NOISY)
    point = cost.at(p)
    assert point.value == pytest.approx(expected, rel=1e-10)
    if model.offsets:
        found = dict(zip(cost.summary.runs, point.offsets, strict=True))
        assert all(np.allclose(found[run], d, rtol=0, atol=1e-14) for run, d in offsets.items())


def stencil(f, p: np.ndarray, u: np.ndarray, h: float) -> np.ndarray:
    """Fourth-order central difference of f along u."""
    return (8 * (f(p + h * u) - f(p - h * u)) - (f(p + 2 * h * u) - f(p - 2 * h * u))) / (12 * h)


@settings(max_examples=4)
@given(seeds)
@pytest.mark.parametrize("weighted", [False, True])
@pytest.mark.parametrize(("name", "effects"), DERIVED)
def test_gradient_and_hessian_are_derivatives(log, name, effects, weighted, seed):
    """Steps of 1e-3 of the bounds (at most 100 for a, b, c): truncation 1e-12, rounding 1e-13 / 1e-3."""
    rng = np.random.default_rng(seed)
    model = build(name, added=effects)
    cost = cost_on(log, model, NOISY)
    if weighted:
        cost = cost.weighted(rng.uniform(0, 2, 57))
    width = np.minimum(model.bounds[1] - model.bounds[0], 100.0)
    base = model.vector(
        {n: -150.0 if n.startswith("a_") else 20.0 for n in model.names if n[:2] in ("a_", "b_", "c_")}
    )
    p, u = base + 0.05 * width * rng.uniform(-1, 1, len(width)), width * rng.uniform(-1, 1, len(width))
    value, gradient, hessian = cost.at(p).derivatives()
    assert value == cost.at(p).value
    assert np.array_equal(hessian, hessian.T)
    slope = stencil(lambda x: cost.at(x).value, p, u, 1e-3)
    assert gradient @ u == pytest.approx(slope, rel=1e-8, abs=1e-8 * np.linalg.norm(gradient * width))
    bend = stencil(lambda x: cost.at(x).derivatives()[1], p, u, 1e-3)
    error = (hessian @ u - bend) * width
    assert np.abs(error).max() < 1e-7 * np.abs((hessian @ u) * width).max()


@pytest.mark.parametrize(
    ("name", "effects"),
    [("stage31", ("hysteresis:half_width_m=1e-6", "time_skew")), ("halbach_planar", ("gain_mismatch",))],
)
def test_derivatives_of_a_tangent_are_derivatives(name, effects):
    """Offsets of runs, and parameters that one channel has for itself."""
    rng, model = np.random.default_rng(1), build(name, added=effects)
    logged = (*model.references, *model.state, *model.channels)
    columns = {c: rng.uniform(-1e-3, 1e-3, 90) for c in dict.fromkeys(logged)}
    log = Log.from_arrays({"run": np.repeat([0, 3, 4], 30), "t_s": np.arange(90) * 1e-3, **columns})
    sigma = dict.fromkeys(logged, 1e-6) | dict.fromkeys(model.channels, 1e-4)
    width = np.minimum(model.bounds[1] - model.bounds[0], 1.0)
    p, u = model.nominal + 1e-3 * width, 0.1 * width * rng.uniform(-1, 1, len(width))
    cost = cost_of(summarise_at(log, model, model.nominal, {}, sigma), sigma)
    assert cost.summary.features.tangent(p) is not None
    _, gradient, hessian = cost.at(p).derivatives()
    slope = stencil(lambda x: cost.at(x).value, p, u, 1e-3)
    assert gradient @ u == pytest.approx(slope, rel=1e-7, abs=1e-7 * np.linalg.norm(gradient * width))
    bend = stencil(lambda x: cost.at(x).derivatives()[1], p, u, 1e-3)
    assert np.abs((hessian @ u - bend) * width).max() < 1e-6 * np.abs((hessian @ u) * width).max()


@pytest.mark.parametrize("noisy", [False, True])
def test_population_is_one_by_one(log, noisy):
    """With and without noise in the columns, whose covariance depends on the point."""
    model = true_model()
    sigma = NOISY if noisy else {c: NOISY[c] for c in HALL}
    merged = cost_of(summarise(log, model).merged(), sigma)
    points = np.array([near(model, seed) for seed in range(7)])
    assert np.allclose(merged.population(points), [merged.at(p).value for p in points], rtol=1e-11)


def test_information_is_half_the_hessian_where_the_reference_is_exact():
    """Noise-free log: at the truth the residuals vanish and Gauss-Newton is the Hessian."""
    model = true_model()
    cost = cost_on(with_noise(record(seed=1, samples=20, sigma={})), model, {c: SIGMAS[c] for c in HALL})
    _, _, hessian = cost.at(model.nominal).derivatives()
    scale = 1 / np.sqrt(np.maximum(np.diag(hessian), 1e-12 * np.diag(hessian).max()))
    information = cost.at(model.nominal).information(0.0).sum(axis=0)
    assert np.allclose(
        2 * information * np.outer(scale, scale), hessian * np.outer(scale, scale), rtol=0, atol=1e-6
    )


# -- noise in reading and reference ----------------------------------------------------------------------


def test_noisy_references_do_not_bias_the_gains():
    """20 um and 20 urad of reference noise attenuate plain least squares by s^2 / <q^2>, seen over 24 seeds.

    <q^2> over the whole campaign is a third of A^2 / 2: 1 % in y (500 um), 2.7 % in x (300 um). The mean over
    seeds scatters by a few 1e-4, so a bias of 4 of its standard errors would be seen, and plain least
    squares (columns without variance) is out by more than 10.
    """
    from hallsym.estimation.optimum import refit

    model = true_model()
    sigma = {**SIGMAS, "x_ref_m": 20e-6, "y_ref_m": 20e-6, "rz_ref_rad": 20e-6}
    plain = {c: sigma[c] for c in HALL}
    held = [model.names.index(n) for n in ("H1y", "H2y", "H3x")]
    gains = [model.names.index(f"eta_{k}") for k in "ABC"]
    errors = {"likelihood": [], "plain": []}
    for seed in range(24):
        summary = summarise(with_noise(record(seed=100 + seed, sigma=sigma), sigma), model)
        for name, stated in (("likelihood", sigma), ("plain", plain)):
            p = refit(cost_of(summary, stated), model.nominal, held)
            errors[name].append((p / model.nominal - 1)[gains])
    mean = {name: np.mean(e, axis=0) for name, e in errors.items()}
    standard = {name: np.std(e, axis=0, ddof=1) / np.sqrt(len(e)) for name, e in errors.items()}
    assert np.all(np.abs(mean["likelihood"]) < 4 * standard["likelihood"])
    assert np.all(mean["plain"] < -10 * standard["plain"])
    assert np.allclose(mean["plain"], [-0.0096, -0.0096, -0.0267], rtol=0.25)
