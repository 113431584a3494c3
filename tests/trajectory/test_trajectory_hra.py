"""Factors, solutions and QR beside arithmetic of 100 digits."""

import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym import InputError
from hallsym.trajectory.choose import chebyshev_nodes
from hallsym.trajectory.factorisation import BERNSTEIN, TRIGONOMETRIC, Basis, factorise, orthogonalise


@pytest.fixture(autouse=True)
def hundred_digits():
    with mpmath.workdps(100):
        yield


def exact(basis: Basis, t: np.ndarray, order: int) -> mpmath.matrix:
    """Collocation matrix of the float64 parameters."""
    rows = []
    for value in map(mpmath.mpf, t.tolist()):
        if basis is BERNSTEIN:
            f, g = value, 1 - value
        else:
            f, g = mpmath.sin((basis.stop + value) / 2), mpmath.sin((basis.stop - value) / 2)
        rows.append([mpmath.binomial(order, j) * f**j * g ** (order - j) for j in range(order + 1)])
    return mpmath.matrix(rows)


def relative(found: np.ndarray, true: mpmath.matrix) -> float:
    return float(mpmath.norm(mpmath.matrix(found.tolist()) - true) / mpmath.norm(true))


@pytest.mark.slow
@pytest.mark.parametrize(("n", "lu"), [(10, 1e-14), (20, 1e-10), (25, 1e-8), (50, 0.1)])
def test_table_1(n, lu):
    t = np.arange(1, n + 1) / (n + 1)
    a = exact(BERNSTEIN, t, n - 1)
    rounded = np.array(a.tolist(), float)
    factors = factorise(BERNSTEIN, t)
    for seed in range(2):
        c = np.random.default_rng(seed).uniform(size=n)
        true = mpmath.lu_solve(a, mpmath.matrix(c.tolist()))
        assert relative(factors.solve(c), true) <= 1e-13
        assert relative(np.linalg.solve(rounded, c), true) >= lu


@pytest.mark.parametrize("basis", [BERNSTEIN, TRIGONOMETRIC], ids=lambda b: b.name)
@pytest.mark.parametrize("closed", [False, True])
def test_every_entry_of_the_inverse_is_right_to_a_few_digits(basis, closed):
    n = 15
    share = np.linspace(0, 1, n) if closed else np.arange(1, n + 1) / (n + 1)
    t = basis.start + share * (basis.stop - basis.start)
    t[-1] = basis.stop if closed else t[-1]
    inverse = mpmath.inverse(exact(basis, t, n - 1))
    found = factorise(basis, t).solve(np.eye(n))
    for i in range(n):
        for j in range(n):
            # zero where a closed end decouples the first and last point
            assert abs(found[i, j] - inverse[i, j]) <= 2e-13 * abs(inverse[i, j]) + 1e-30


@settings(max_examples=15)
@given(st.integers(2, 7), st.integers(0, 12), st.booleans(), st.integers(0, 10**6))
def test_least_squares(columns, more, closed, seed):
    rng = np.random.default_rng(seed)
    points = columns + more
    share = np.cumsum(rng.uniform(0.1, 1, points + 1))
    share = share[:-1] / share[-1]
    if closed:
        share = (share - share[0]) / (share[-1] - share[0])
    for basis in (BERNSTEIN, TRIGONOMETRIC):
        t = np.clip(basis.start + share * (basis.stop - basis.start), basis.start, basis.stop)
        a = exact(basis, t, columns - 1)
        p = rng.normal(size=(points, 2))
        q = orthogonalise(factorise(basis, t, columns))
        pseudo = mpmath.inverse(a.T * a) * a.T
        assert relative(q.solve(p), pseudo * mpmath.matrix(p.tolist())) < 1e-11


def test_r_has_full_accuracy_where_householder_loses_half_the_digits():
    n = 26
    t = np.arange(1, 31) / 31
    a = exact(BERNSTEIN, t, n - 1)
    with mpmath.workdps(60):
        _, r = mpmath.qr(a, mode="skinny")
        true = [abs(r[k, k]) for k in range(n)]
    q = orthogonalise(factorise(BERNSTEIN, t, n))
    ours = np.ldexp(q.pivot, q.exponent)
    assert max(abs(x / y - 1) for x, y in zip(ours, true, strict=True)) < 1e-13
    lapack = np.abs(np.diag(np.linalg.qr(np.array(a.tolist(), float))[1]))
    assert max(abs(x / y - 1) for x, y in zip(lapack, true, strict=True)) > 1e-9


def test_a_thousand_control_points_neither_overflow_nor_underflow():
    for t in (np.linspace(0, 1, 1000), chebyshev_nodes(1000)):
        factors = factorise(BERNSTEIN, t)
        assert np.isfinite(factors.lower).all()
        assert np.isfinite(factors.upper).all()
        assert ((factors.pivot >= 0.5) & (factors.pivot < 1)).all()


def test_bad_parameters():
    for t, columns, said in (
        ([0.1, 0.5, 0.5], None, r"number 3 \(0.5\) repeats number 2 \(0.5\); sort the points"),
        ([0.5, 0.1], None, r"number 2 \(0.1\) is less than number 1"),
        ([0.1, 0.2, 0.3], 4, "3 points for 4 control points"),
    ):
        with pytest.raises(InputError, match=said):
            factorise(BERNSTEIN, np.array(t), columns)
    with pytest.raises(InputError, match="larger than float64"):
        factorise(BERNSTEIN, np.linspace(0, 1, 1000)).solve(
            np.random.default_rng(0).normal(size=1000) * 1e200
        )
