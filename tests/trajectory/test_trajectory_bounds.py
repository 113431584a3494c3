"""Power series enclose what mpmath computes; bounds enclose what is sampled."""

import mpmath
import numpy as np
import pytest
from cycloid import cycloid, through
from flint import arb, arb_series
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym import InputError
from hallsym.trajectory import Curve, bound, nominal
from hallsym.trajectory.choose import METHODS, Target, method_named
from hallsym.trajectory.curve import FgForm
from hallsym.trajectory.factorisation import TRIGONOMETRIC
from hallsym.trajectory.nominal import FUNCTIONS, read_span, read_value

INNER = {"asin": "t/4", "acos": "t/4", "log": "t", "sqrt": "t", "tan": "t/3"}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_taylor_coefficients_of_every_function(name):
    inner = INNER.get(name, "t")
    curve = nominal(f"x = {name}({inner})*t**2 + t**-1.5/(1 + t); y = t**t", ("t", "0.5", "2"))
    scale, half = {"t/4": 4, "t/3": 3, "t": 1}[inner], 0.05

    def x(t):
        return getattr(mpmath, name)(t / scale) * t**2 + t ** mpmath.mpf(-1.5) / (1 + t)

    with mpmath.workdps(40):
        for m in (0.6, 1.1, 1.7):
            thin, wide = (curve.series(arb_series([at, 1])) for at in (arb(m), arb(m, half)))
            for k, function in enumerate((x, lambda t: t**t)):
                for shift in (0, -half, 0.3 * half, half):
                    true = mpmath.taylor(function, mpmath.mpf(m + shift), 6)
                    found = [(wide if shift else thin)[k][j] for j in range(7)]
                    assert all(b.overlaps(arb(mpmath.nstr(c, 35))) for b, c in zip(found, true, strict=True))
                    assert shift or all(float(b.rad()) <= 1e-10 * (1 + abs(b)) for b in found)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_the_bound_holds_every_sample_and_is_tight(method):
    target = Target(cycloid())
    curve = target.made(method, 9, 6)
    found = bound(curve, cycloid())
    sampled = target.sampled(curve)
    assert sampled <= found.at_most * (1 + 1e-12)
    assert found.at_least <= found.at_most <= sampled * 1.005
    at = np.array([found.where])
    apart = target.errors(curve, at / (2 * np.pi), cycloid()(at))
    assert np.linalg.norm(apart) == pytest.approx(found.at_least, rel=1e-6)


@settings(max_examples=25)
@given(st.integers(1, 8), st.integers(0, 10**6), st.booleans())
def test_the_bound_of_any_curve_holds(order, seed, angles):
    rng = np.random.default_rng(seed)
    control = rng.normal(size=(order + 1, 2)) * 1e-3
    text = "x = r*cos(3*t)*exp(-t); y = r*t/(1 + t**2)"
    target = nominal(text, ("t", "-1", "2"), {"r": 1e-3})
    curve = Curve(FgForm(TRIGONOMETRIC, control), -1.0, 2.0)
    if angles:
        target = nominal("x = r*cos(3*t)*exp(-t); rz = r*t/(1 + t**2)", ("t", "-1", "2"), {"r": 1e-3})
        curve = Curve(FgForm(TRIGONOMETRIC, control), -1.0, 2.0, ("x_m", "rz_rad"))
    found = bound(curve, target)
    t = np.linspace(-1, 2, 5001)
    e = curve(t) - target(t)
    size = np.abs(e[:, 0]) if angles else np.linalg.norm(e, axis=1)
    assert size.max() <= found.at_most <= size.max() * 1.01 + 1e-15
    if angles:
        assert np.abs(e[:, 1]).max() <= found.rotation_rad <= np.abs(e[:, 1]).max() * 1.3 + 1e-12


@pytest.mark.slow
@pytest.mark.parametrize(("method", "nodes"), [("bernstein-chebyshev", 80), ("trigonometric", 50)])
def test_the_bound_is_as_tight_where_control_points_are_large(method, nodes):
    """The curve of the stored numbers in 60 digits: sampling comes within 1 % of the bound."""
    curve = through(method, nodes)
    found, form, n = bound(curve, cycloid()), curve.form, nodes - 1
    near = np.linspace(max(found.where - 1e-3, 0), min(found.where + 1e-3, 2 * np.pi), 21)
    with mpmath.workdps(60):
        a, b = map(mpmath.mpf, form.domain)

        def off(t):
            u = a + (mpmath.mpf(t) - curve.start) / (mpmath.mpf(curve.stop) - curve.start) * (b - a)
            f, g = (u, 1 - u) if a == 0 else (mpmath.sin((b + u) / 2), mpmath.sin((b - u) / 2))
            shares = [mpmath.binomial(n, k) * f**k * g ** (n - k) for k in range(n + 1)]
            x, y = (mpmath.fdot(shares, map(mpmath.mpf, column)) for column in form.control.T.tolist())
            r = mpmath.mpf(1e-3)
            return float(mpmath.hypot(x - r * (t - mpmath.sin(t)), y - r * (1 - mpmath.cos(t))))

        largest = max(map(off, near.tolist()))
    assert 0.99 * found.at_most <= largest <= found.at_most


@pytest.mark.parametrize("points", [2, 7, 12])
@pytest.mark.parametrize(
    ("text", "low", "high"),
    [
        ("x = t**2; y = t**3", "-1", "1.3"), ("x = t - sin(t); y = 1 - cos(t)", "-3", "9.1"),
        ("x = t**2; y = 0*t", "-1", "1"), ("x = sin(t); y = 0*t", "0", "7"), ("x = t; y = 2*t", "-1", "1"),
    ],
)  # fmt: skip
def test_a_polyline_is_as_far_as_its_chords_between_their_ends(text, low, high, points):
    """Curves with a cusp and such that turn back have points beyond the ends of the nearest chord."""
    curve = nominal(text, ("t", low, high))
    line = Target(curve).made(method_named("linear"), points, 0)
    found, at = bound(line, curve), np.linspace(0, 1, 20001)
    nodes, k = line.form.control, np.minimum((at * (points - 1)).astype(int), points - 2)
    chord, off = nodes[k + 1] - nodes[k], Target(curve).at(at) - nodes[k]
    size = np.maximum((chord**2).sum(axis=1), 1e-300)
    share = np.clip((off * chord).sum(axis=1) / size, 0, 1)
    largest = np.linalg.norm(off - share[:, None] * chord, axis=1).max()
    assert largest <= found.at_most + 1e-14
    assert found.at_most <= largest * 1.002 + 1e-13
    assert Target(curve).sampled(line) == pytest.approx(largest, rel=1e-2, abs=1e-14)


def test_what_cannot_be_bounded_is_said():
    root = nominal("x = sqrt(t); y = t", ("t", "0", "1"))
    with pytest.raises(InputError, match="cannot be bounded"):
        bound(Target(root).made(METHODS[0], 5, 0), root)
    with pytest.raises(InputError, match="x is not a finite number at t = 0"):
        nominal("x = 1/t; y = t", ("t", "0", "1"))(np.array([0.0]))
    with pytest.raises(InputError, match="the nominal one x_m"):
        bound(through("bernstein", 5), nominal("x = t", ("t", "0", "1")))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = __import__('os')", "Function '__import__'"),
        ("x = [t]", "may hold"),
        ("x = t if t else 1", "may hold only"),
        ("x = True", "may hold only"),
        ("x = sni(t)", "did you mean 'sin'"),
        ("x = q*t", "--value q="),
        ("y", "must be like"),
        ("x = t; x = t", "twice"),
        ("x = t; h = 3*t", "'h' is not used"),
        ("x = t^2", r"\*\* for a power"),
        ("rz = t", "at least one of x, y and z"),
        ("x = t = 3", "not an expression"),
        ("x = " + "(" * 4000, "not an expression"),
        ("x = " + "t+" * 6000, "10000 characters"),
        ("x = 1e400*t", "not a finite number"),
        ("sin = t", "already has"),
        ("x = " + "-" * 3000 + "t", "."),
    ],
)
def test_only_expressions_are_taken(text, said):
    with pytest.raises(InputError, match=said):
        nominal(text, ("t", "0", "1"))(np.array([0.5]))


def test_values_and_ranges():
    assert read_value("r=1mm") == ("r", 1e-3)
    assert read_value("n=2*pi") == ("n", 2 * np.pi)
    assert read_value("a=0.5deg")[1] == pytest.approx(np.pi / 360)
    assert read_span("t=0:2*pi") == ("t", "0", "2*pi")
    for bad in ("r", "r=", "pi=3", "r=1lightyear", "x=2"):
        with pytest.raises(InputError):
            read_value(bad)
    for bad in ("t", "t=0", "t=:1", "0:1"):
        with pytest.raises(InputError, match="PARAMETER=FIRST:LAST"):
            read_span(bad)
    with pytest.raises(InputError, match="lesser to the greater"):
        nominal("x = t", ("t", "1", "0"))
    with pytest.raises(InputError, match="'k' is not used"):
        nominal("x = t", ("t", "0", "1"), {"k": 1.0})
