"""Curves of high relative accuracy: what they cost beside LAPACK and scipy, and what they gain.

    python tests/benchmarks/bench_trajectory.py

Times are the least of many turns on one thread. LAPACK's LU (getrf, getrs) is given its matrix; ours starts
from the parameters. scipy's BSpline evaluates the same polynomial, and a cubic spline of 50 control points.
Errors are relative, of the solution, in the 2-norm, against 100 digits where mpmath (extra "test") is there.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline
from scipy.linalg import lu_factor, lu_solve

from hallsym.trajectory import BERNSTEIN, factorise, nominal, of_nominal, orthogonalise
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.text import choice_text

SIZES = {50: 10.0, 200: 5.0}
"""Size -> how many times LAPACK's LU factorising and solving may take."""
SAMPLES = 1_000_000
EVALUATION = 3.0
"""How many times scipy's BSpline evaluating may take."""


def main() -> int:
    """Print the tables."""
    solving()
    fitting()
    evaluating()
    accuracy()
    choosing()
    return 0


def least(function: Callable[[], object], turns: int = 200) -> float:
    """Least time of a call [s]."""
    best = np.inf
    for _ in range(turns):
        start = perf_counter()
        function()
        best = min(best, perf_counter() - start)
    return float(best)


def solving() -> None:
    """Factorise and solve, one right side, beside LU of the collocation matrix."""
    print("factorise and solve          ours [us]   (factors, solve)   LU [us]   ratio   asked")
    for n, asked in SIZES.items():
        t = np.arange(1, n + 1) / (n + 1)
        c = np.random.default_rng(0).uniform(size=n)
        matrix, factors = FgForm(BERNSTEIN, np.eye(n)).evaluate(t), factorise(BERNSTEIN, t)
        one, two = least(lambda t=t: factorise(BERNSTEIN, t)), least(lambda f=factors, c=c: f.solve(c))
        lu = least(lambda a=matrix, c=c: lu_solve(lu_factor(a, check_finite=False), c, check_finite=False))
        ours = one + two
        parts = f"{1e6 * one:11.0f}{1e6 * two:9.0f}"
        print(f"n = {n:<4d}{1e6 * ours:28.0f}{parts}{1e6 * lu:11.0f}{ours / lu:8.1f}{asked:8.0f}")


def fitting() -> None:
    """Least squares of two coordinates beside LAPACK's lstsq."""
    print("\nleast squares                 ours [ms]   lstsq [ms]")
    for points, control in ((51, 10), (1001, 14), (200, 40)):
        t = np.arange(1, points + 1) / (points + 1)
        p = np.random.default_rng(0).normal(size=(points, 2))
        matrix = FgForm(BERNSTEIN, np.eye(control)).evaluate(t)
        ours = least(lambda t=t, p=p, k=control: orthogonalise(factorise(BERNSTEIN, t, k)).solve(p), 5)
        lapack = least(lambda a=matrix, p=p: np.linalg.lstsq(a, p, rcond=None), 5)
        print(f"{points:5d} points, {control:3d} control{1e3 * ours:14.2f}{1e3 * lapack:13.2f}")


def evaluating() -> None:
    """Evaluate a million points of a plane curve."""
    print(f"\n{SAMPLES} points                  ours [ms]   BSpline [ms]   ratio   asked")
    t = np.random.default_rng(0).uniform(size=SAMPLES)
    cubic = make_interp_spline(np.linspace(0, 1, 50), np.random.default_rng(0).normal(size=(50, 2)))
    against_cubic = least(lambda: cubic(t), 5)
    for order in (3, 11, 20):
        form = FgForm(BERNSTEIN, np.random.default_rng(0).normal(size=(order + 1, 2)))
        spline = BSpline(np.repeat([0.0, 1.0], order + 1), form.control, order)
        ours, theirs = least(lambda f=form: f.evaluate(t), 5), least(lambda s=spline: s(t), 3)
        print(f"order {order:<3d}{1e3 * ours:31.0f}{1e3 * theirs:15.0f}{ours / theirs:8.2f}{EVALUATION:8.0f}")
        if order == 11:
            ratio = ours / against_cubic
            times = f"{1e3 * ours:15.0f}{1e3 * against_cubic:15.0f}{ratio:8.2f}"
            print(f"  the same beside a cubic{times}{EVALUATION:8.0f}")


def accuracy() -> None:
    """Table 1: relative error of the solution by the factors and by LU."""
    try:
        import mpmath
    except ImportError:
        print("\nTable 1 needs mpmath: not run")
        return
    print("\nTable 1                     ours (largest of 5)     LU (smallest of 5)")
    with mpmath.workdps(100):
        for n in (10, 20, 25, 50):
            t = np.arange(1, n + 1) / (n + 1)
            exact = mpmath.matrix(
                [[mpmath.binomial(n - 1, j) * v**j * (1 - v) ** (n - 1 - j) for j in range(n)]
                 for v in map(mpmath.mpf, t.tolist())]
            )  # fmt: skip
            rounded, factors, found = np.array(exact.tolist(), float), factorise(BERNSTEIN, t), []
            for seed in range(5):
                c = np.random.default_rng(seed).uniform(size=n)
                true = mpmath.lu_solve(exact, mpmath.matrix(c.tolist()))
                pair = (factors.solve(c), np.linalg.solve(rounded, c))
                found.append(
                    [float(mpmath.norm(mpmath.matrix(x.tolist()) - true) / mpmath.norm(true)) for x in pair]
                )
            print(f"n = {n:<4d}{max(a for a, _ in found):30.1e}{min(b for _, b in found):23.1e}")


def choosing() -> None:
    """The whole table of methods for the article's cycloid."""
    curve = nominal("x = r*(t - sin(t)); y = r*(1 - cos(t))", ("t", "0", "2*pi"), {"r": 1e-3})
    start = perf_counter()
    choice = of_nominal(curve, 0.05e-6)
    print(f"\nevery method to 0.05 um, bounded: {perf_counter() - start:.2f} s\n{choice_text(choice)}")


if __name__ == "__main__":
    raise SystemExit(main())
