"""Intervals and Taylor coefficients enclose what mpmath computes; bounds enclose what is sampled."""

import mpmath
import numpy as np
import pytest
from cycloid import WHOLE, cycloid, through
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hallsym import InputError
from hallsym.trajectory import Curve, bound, nominal, trigonometric
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.intervals import Interval, sine
from hallsym.trajectory.methods import METHODS
from hallsym.trajectory.nominal import FUNCTIONS, read_span, read_value
from hallsym.trajectory.target import Target

INNER = {"asin": "t/4", "acos": "t/4", "log": "t", "sqrt": "t", "tan": "t/3"}
finite = st.floats(-1e3, 1e3, allow_nan=False)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_taylor_coefficients_of_every_function(name):
    inner = INNER.get(name, "t")
    curve = nominal(f"x = {name}({inner})*t**2 + t**-1.5/(1 + t); y = t**t", ("t", "0.5", "2"))
    middle, half = np.array([0.6, 1.1, 1.7]), 0.05
    thin, wide = curve.taylor(Interval.of(middle), 6), curve.taylor(Interval(middle - half, middle + half), 6)
    scale = {"t/4": 4, "t/3": 3, "t": 1}[inner]
    with mpmath.workdps(40):

        def x(t):
            return getattr(mpmath, name)(t / scale) * t**2 + t ** mpmath.mpf(-1.5) / (1 + t)

        for k, function in enumerate((x, lambda t: t**t)):
            for j, m in enumerate(middle.tolist()):
                true = mpmath.taylor(function, mpmath.mpf(m), 6)
                for low, high, c in zip(_at(thin[k], j)[0], _at(thin[k], j)[1], true, strict=True):
                    assert low <= c <= high
                    assert high - low <= 1e-10 * (1 + abs(c))
                for shift in (-half, 0.3 * half, half):
                    moved = mpmath.taylor(function, mpmath.mpf(m + shift), 6)
                    for low, high, c in zip(*_at(wide[k], j), moved, strict=True):
                        assert low <= c <= high


def _at(terms, j):
    return [term.low[j] for term in terms], [term.high[j] for term in terms]


@example(0.0, 0.0, -1.0, -2.225e-313, 0.0, 0.0)
@example(1.0, 2.0, 2.225e-313, 2.225e-313, 0.0, 0.5)
@given(finite, finite, finite, finite, st.floats(0, 1), st.floats(0, 1))
def test_interval_operations_enclose(a, b, c, d, p, q):
    one, two = Interval.of(np.sort([a, b])[:1]), Interval.of(np.sort([c, d])[:1])
    one, two = Interval(one.low, np.maximum([a], [b])), Interval(two.low, np.maximum([c], [d]))
    x, y = min(a, b) + p * abs(a - b), min(c, d) + q * abs(c - d)
    x, y = min(max(x, one.low[0]), one.high[0]), min(max(y, two.low[0]), two.high[0])
    with mpmath.workdps(60):
        x, y = mpmath.mpf(x), mpmath.mpf(y)
        for found, true in ((one + two, x + y), (one - two, x - y), (one * two, x * y)):
            assert found.low[0] <= true <= found.high[0]
        if y != 0:
            quotient = one / two
            assert quotient.low[0] <= x / y <= quotient.high[0]
        assert sine(one).low[0] <= mpmath.sin(x) <= sine(one).high[0]
        cosine = sine(one, np.pi / 2)
        assert cosine.low[0] <= mpmath.cos(x) <= cosine.high[0]


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_the_bound_holds_every_sample_and_is_tight(method):
    target = Target(cycloid())
    curve = target.made(method, method.nodes[0], 9, 6)
    if method.name == "aaa":
        curve = target.made(method, "equidistant", 14, 0)
    found = bound(curve, cycloid())
    sampled = target.sampled(curve)
    assert sampled <= found.at_most * (1 + 1e-12)
    assert found.at_least <= found.at_most <= sampled * 1.005
    assert found.where == pytest.approx(np.clip(found.where, 0, WHOLE))


@settings(max_examples=25)
@given(st.integers(1, 8), st.integers(0, 10**6), st.booleans())
def test_the_bound_of_any_curve_holds(order, seed, angles):
    rng = np.random.default_rng(seed)
    control = rng.normal(size=(order + 1, 2)) * 1e-3
    basis = trigonometric(rng.uniform(0.3, 2.5))
    text = "x = r*cos(3*t)*exp(-t); y = r*t/(1 + t**2)"
    target = nominal(text, ("t", "-1", "2"), {"r": 1e-3})
    curve = Curve(FgForm(basis, control), -1.0, 2.0)
    if angles:
        target = nominal("x = r*cos(3*t)*exp(-t); rz = r*t/(1 + t**2)", ("t", "-1", "2"), {"r": 1e-3})
        curve = Curve(FgForm(basis, control), -1.0, 2.0, ("x_m", "rz_rad"))
    found = bound(curve, target)
    t = np.linspace(-1, 2, 5001)
    e = curve(t) - target(t)
    size = np.abs(e[:, 0]) if angles else np.linalg.norm(e, axis=1)
    assert size.max() <= found.at_most <= size.max() * 1.01 + 1e-15
    if angles:
        assert np.abs(e[:, 1]).max() <= found.rotation_rad <= np.abs(e[:, 1]).max() * 1.3 + 1e-12


def test_what_cannot_be_bounded_is_said():
    root = nominal("x = sqrt(t); y = t", ("t", "0", "1"))
    with pytest.raises(InputError, match="cannot be bounded"):
        bound(Target(root).made(METHODS[0], "equidistant", 5, 0), root)
    with pytest.raises(InputError, match="x is not a finite number at t = 0"):
        nominal("x = 1/t; y = t", ("t", "0", "1"))(np.array([0.0]))
    with pytest.raises(InputError, match="the nominal one x_m"):
        bound(through("bernstein", 5), nominal("x = t", ("t", "0", "1")))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("x = __import__('os')", "Function '__import__'"),
        ("x = t.real", "may hold only"),
        ("x = [t]", "may hold"),
        ("x = t if t else 1", "may hold only"),
        ("x = lambda: 1", "may hold only"),
        ("x = 'a'", "may hold only"),
        ("x = True", "may hold only"),
        ("x = (t := 3)", "may hold only"),
        ("x = sni(t)", "did you mean 'sin'"),
        ("x = sin(t, t)", "Function 'sin'"),
        ("x = q*t", "--value q="),
        ("y", "must be like"),
        ("x = t; x = t", "twice"),
        ("x = t; h = 3*t", "'h' is not used"),
        ("x = t^2", r"\*\* for a power"),
        ("rz = t", "at least one of x, y and z"),
        ("x = t = 3", "not an expression"),
        ("x =", "not an expression"),
        ("x = " + "(" * 4000, "not an expression"),
        ("x = " + "t+" * 6000, "10000 characters"),
        ("x = 1e400*t", "not a finite number"),
        ("sin = t", "already has"),
        ("x = " + "-" * 3000 + "t", "."),
    ],
)
def test_only_expressions_are_taken(text, said):
    with pytest.raises(InputError, match=said) as caught:
        nominal(text, ("t", "0", "1"))(np.array([0.5]))
    assert len(str(caught.value)) < 300


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
