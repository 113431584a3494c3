"""Tolerances: indices against closed forms, and errors against the article's matrix typed again in numpy.

Facts: a linear error has S_j = T_j = share of variance, whatever the distribution; Ishigami's function has
published indices; probes that mirror each other have equal indices; what no reading sees has index 0; error
and tolerance scale together.
"""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from twins import pm

from hallsym.families import build
from hallsym.simulation import paper_campaign
from hallsym.uncertainty import tolerances as study
from hallsym.uncertainty.ranges import given_tolerances
from hallsym.uncertainty.tolerances import Tolerances, Workspace, tolerances, workspace_of

SMALL = {
    **{f"H{k}{axis}_um": 100 for k in (1, 2, 3) for axis in "xy"},
    **{f"eta_{k}_percent": 0.03 for k in "ABC"},
    **{f"theta_{k}_mrad": 0.25 for k in "ABC"},
}
"""Small enough for the error to be linear in them to 1e-3."""


@pytest.fixture(scope="module")
def small(model, somewhere) -> Tolerances:
    return tolerances(model, somewhere, ranges=SMALL, samples=256, seed=1)


def error_by_hand(machines: np.ndarray, names, where: Workspace) -> np.ndarray:
    """PM0^-1 diag(eta) PM q - q of Eq. (15), (n_pose, machines, points)."""
    designed = dict(zip(names, build("stage15").nominal, strict=True))
    out = []
    for row in machines:
        v = dict(zip(names, row, strict=True))
        reading = np.array([[v["eta_A"]], [v["eta_B"]], [v["eta_C"]]]) * (pm(v) @ where.pose)
        out.append(np.linalg.solve(pm(designed), reading) - where.pose)
    return np.moveaxis(np.array(out), 0, 1)


def shares_by_hand(model, ranges, where: Workspace) -> tuple[np.ndarray, np.ndarray]:
    """Variance of the linearised error per tolerance, (n_pose, n), as shares, and the rms."""
    parts = []
    for k, t in enumerate(ranges):
        h = 1e-3 * t.std
        pair = np.tile(model.nominal, (2, 1))
        pair[0, k] += h
        pair[1, k] -= h
        e = error_by_hand(pair, model.names, where)
        slope = (e[:, 0] - e[:, 1]) / (2 * h)
        parts.append((slope**2).mean(axis=1) * t.std**2)
    variance = np.array(parts).T
    return variance / variance.sum(axis=1, keepdims=True), np.sqrt(variance.sum(axis=1))


# -- closed forms ----------------------------------------------------------------------------------------


def test_a_linear_error_is_shared_by_variance(model, somewhere, small):
    shares, rms = shares_by_hand(model, small.tolerances, somewhere)
    for c, share, indices in zip(model.pose, shares, small.indices.values(), strict=True):
        assert np.all(np.abs(indices.first - share) <= indices.first_half + 1e-3), c
        assert np.all(np.abs(indices.total - share) <= indices.total_half + 1e-3), c
    assert small.errors.rms == pytest.approx(rms, rel=0.06)  # three standard errors


def test_tightening_a_linear_error_takes_its_share(model, somewhere, small):
    shares, _ = shares_by_hand(model, small.tolerances, somewhere)
    expected = 1 - np.sqrt(1 - shares.T)
    assert np.all(np.abs(small.worth.exact - expected) <= small.worth.exact_half + 1e-3)


def test_what_is_linear_needs_no_draws(model, somewhere):
    """Gains enter a reading linearly and are decoded so: the fewest machines know all but the quantiles."""
    ranges = given_tolerances(
        model, {f"eta_{k}_percent": w for k, w in zip("ABC", (1, 2, 3), strict=True)}, "exact"
    )
    few, more = (tolerances(model, somewhere, ranges=ranges, samples=n, seed=2) for n in (16, 256))
    assert max(few.widest, more.widest) < 1e-9
    assert few.worth.exact == pytest.approx(more.worth.exact, abs=1e-9)
    assert few.errors.rms == pytest.approx(more.errors.rms, rel=1e-9)
    assert few.errors.rms_95 == pytest.approx(more.errors.rms_95, rel=0.01)


def test_as_many_machines_as_make_intervals_sharp(model, somewhere):
    """A zero anywhere on the circle leaves nothing linear: no worse than without a control variate."""
    assert tolerances(model, somewhere).samples == study.LEAST_SAMPLES
    around = tolerances(build("rotary"))
    assert study.LEAST_SAMPLES < around.samples <= study.USUAL_SAMPLES
    assert around.sharp
    assert around.points == 32  # of four ramps, the example of its family


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stage31", "halbach", "rings3"])
def test_intervals_hold_what_many_machines_say(name):
    """Seventy or more intervals at 95 % from few machines, beside those of sixteen times as many."""
    model = build(name)
    few = tolerances(model, seed=11)
    many = tolerances(model, samples=16 * few.samples, seed=12)
    off = []
    for c in model.pose:
        one, other = few.indices[c], many.indices[c]
        for kind in ("first", "total"):
            half = np.hypot(getattr(one, f"{kind}_half"), getattr(other, f"{kind}_half"))
            off += list(np.abs(getattr(one, kind) - getattr(other, kind)) > half + 1e-12)
    half = np.hypot(few.worth.exact_half, many.worth.exact_half)
    off += list((np.abs(few.worth.exact - many.worth.exact) > half + 1e-12).ravel())
    assert np.mean(off) < 0.1
    assert few.errors.rms_95 == pytest.approx(many.errors.rms_95, rel=0.06)  # three standard errors


def ishigami(u: np.ndarray) -> np.ndarray:
    """Ishigami and Homma 1990, with a = 7, b = 0.1."""
    x = np.pi * (2 * u - 1)
    return np.sin(x[..., 0]) + 7 * np.sin(x[..., 1]) ** 2 + 0.1 * x[..., 2] ** 4 * np.sin(x[..., 0])


def test_ishigami():
    """Variance a^2/8 + b pi^4/5 + b^2 pi^8/18 + 1/2, in parts known in closed form."""
    a, b, pi = 7, 0.1, np.pi
    alone = np.array([0.5 * (1 + b * pi**4 / 5) ** 2, a**2 / 8, 0.0])
    together = b**2 * pi**8 * 8 / 225
    whole = alone.sum() + together
    first, total = alone / whole, (alone + np.array([together, 0, together])) / whole
    assert first == pytest.approx([0.3139, 0.4424, 0], abs=5e-5)
    y = ishigami(study.design(3, 2048, seed=3))
    found = study.field_indices(study.moments(y[..., None], y[:, [0, -1]].mean(keepdims=True)[0]), seed=3)
    assert np.all(np.abs(found.first - first) <= found.first_half)
    assert np.all(np.abs(found.total - total) <= found.total_half)
    assert found.widest < 0.1


# -- another implementation ------------------------------------------------------------------------------


def test_a_field_of_one_point_is_what_salib_makes_of_a_scalar():
    """Indices, intervals of two bootstraps of 200 resamples, which scatter by 5 %, and the design."""
    pytest.importorskip("SALib")
    from SALib.analyze.sobol import analyze
    from SALib.sample.sobol import sample

    problem = {"num_vars": 3, "names": list("abc"), "bounds": [[0.0, 1.0]] * 3}
    u = study.design(3, 1024, seed=2)
    np.testing.assert_array_equal(u.reshape(-1, 3), sample(problem, 1024, calc_second_order=False, seed=2))
    y = ishigami(u)
    found = study.field_indices(study.moments(y[..., None], np.array([y[:, [0, -1]].mean()])), seed=4)
    theirs = analyze(problem, y.ravel(), calc_second_order=False, num_resamples=200, seed=5)
    assert found.first == pytest.approx(theirs["S1"], abs=2e-3)
    assert found.total == pytest.approx(theirs["ST"], abs=2e-3)
    assert found.first_half == pytest.approx(theirs["S1_conf"], rel=0.3)
    assert found.total_half == pytest.approx(theirs["ST_conf"], rel=0.3)


def test_errors_are_those_of_the_articles_matrix(model):
    """Monte Carlo with other random numbers and the model typed again; within five standard errors."""
    where, rng = workspace_of(model, paper_campaign(), 4), np.random.default_rng(9)
    found = tolerances(model, where, samples=256, seed=4)
    width = np.array([t.width for t in found.tolerances])
    machines = model.nominal + rng.uniform(-1, 1, (1000, len(width))) * width
    square = (error_by_hand(machines, model.names, where) ** 2).mean(axis=2)
    assert np.all(
        np.abs(found.errors.rms**2 - square.mean(axis=1)) < 5 * square.std(axis=1) / np.sqrt(1000 / 2)
    )
    rms = np.sqrt(square)
    assert found.errors.rms_95 == pytest.approx(np.quantile(rms, 0.95, axis=1), rel=0.1)


# -- symmetry, limits, scaling ---------------------------------------------------------------------------


def test_what_no_reading_sees_has_no_index(model, somewhere):
    """H1y enters as H1y sin(theta_A) only: without misalignment it is nothing."""
    ranges = {k: v for k, v in SMALL.items() if not k.startswith("theta")}
    found = tolerances(
        model, somewhere, ranges=given_tolerances(model, ranges, others="exact"), samples=64, seed=0
    )
    for name in ("H1y", "H2y", "H3x"):
        j = found.active.index(name)
        assert all(i.first[j] == i.total[j] == 0 for i in found.indices.values()), name
        assert np.all(found.worth.exact[j] == 0)
    assert not any(n.startswith("theta") for n in found.active)


@settings(max_examples=6, deadline=None)
@given(
    widths=st.lists(st.floats(0.1, 10), min_size=3, max_size=3),
    factor=st.floats(0.1, 0.9),
    seed=st.integers(0, 2**20),
)
def test_error_and_tolerance_scale_together(widths, factor, seed):
    """Gains enter a reading linearly: all halved halves every error and leaves every index."""
    model, where = build("stage15"), Workspace(np.array([[3e-4], [5e-4], [1e-4]]), np.zeros((3, 1)))

    def at(scale: float) -> Tolerances:
        ranges = {f"eta_{k}_percent": scale * w for k, w in zip("ABC", widths, strict=True)}
        return tolerances(
            model, where, ranges=given_tolerances(model, ranges, "exact"), samples=16, seed=seed
        )

    one, other = at(1.0), at(factor)
    assert other.errors.rms == pytest.approx(factor * one.errors.rms, rel=1e-9)
    for c in model.pose:
        assert other.indices[c].total == pytest.approx(one.indices[c].total, abs=1e-8)
    assert other.worth.exact == pytest.approx(one.worth.exact, abs=1e-8)


def test_limits_beside_the_designed_value_are_an_error_common_to_all(model, somewhere):
    """Gains from 0.8 to 0.9: the mean machine decodes 0.85 q."""
    ranges = given_tolerances(model, {f"eta_{k}": [0.8, 0.9] for k in "ABC"}, "exact")
    found = tolerances(model, somewhere, ranges=ranges, samples=256)
    expected = 0.15 * np.sqrt((somewhere.pose**2).mean(axis=1))
    assert found.errors.mean == pytest.approx(expected, rel=1e-3)
    rz = found.worth.exact[found.active.index("eta_A"), 2]
    assert rz < -1  # A without the shift that B keeps: their difference is what Rz is made of


# -- the study itself ------------------------------------------------------------------------------------


def test_the_papers_ranking(paper):
    """Gains of A and B first, then their angles; probe C matters for x only."""
    assert set(paper.ranking[:4]) == {"eta_A", "eta_B", "theta_A", "theta_B"}
    assert set(paper.ranking[-3:]) == {"H1y", "H2y", "H3x"}
    x = paper.indices["x_m"].total
    assert paper.active[int(np.argmax(x))] == "theta_C"


def test_the_seed_decides_everything(model, somewhere):
    def numbers(seed: int) -> dict:
        return tolerances(model, somewhere, samples=32, seed=seed).to_dict()

    np.random.seed(1)  # noqa: NPY002 -- global state takes no part
    one = numbers(0)
    np.random.seed(2)  # noqa: NPY002
    assert one == numbers(0)
    assert one != numbers(1)
    json.dumps(one)


def test_a_workspace_holds_the_peaks_of_the_sines(model):
    where = workspace_of(model, paper_campaign())
    assert where.points == 57 * 8
    assert np.abs(where.pose).max(axis=1) == pytest.approx([300e-6, 500e-6, 300e-6], rel=1e-9)
    assert (where.pose[1] ** 2).mean() == pytest.approx(500e-6**2 / 6, rel=1e-9)
    assert np.abs(where.state).max(axis=1) == pytest.approx([250e-6, 500e-6, 500e-6])
