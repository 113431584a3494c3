"""The arithmetic of a budget: published budgets, distributions of scipy, algebra of variances."""

from math import inf, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from hallsym.errors import InputError
from hallsym.uncertainty import Budget, Source, read_budget
from hallsym.uncertainty.gum import DIVISORS

ROOT = Path(__file__).resolve().parents[2]
SIZES = st.floats(1e-9, 1e3)
SLOPES = st.floats(-1e3, 1e3)


def budget(*sources: Source, **more) -> Budget:
    return Budget("y", "m", sources, **more)


# -- published budgets -----------------------------------------------------------------------------------


def test_nanopositioning_budget_of_micromachines_2019():
    """Table 2 of doi:10.3390/mi10090597: U (k = 2) = 500.9 nm."""
    found, unit = read_budget(ROOT / "data" / "micromachines2019" / "table2_budget.toml")
    assert unit == "nm"
    assert found.factor == 2
    assert round(1e9 * found.expanded, 1) == 500.9
    by_hand = sqrt(700**2 / 12 + 1.58**2 / 12 + 99**2 + 110**2)
    assert found.std == pytest.approx(1e-9 * by_hand, rel=1e-12)


def test_gauge_block_of_gum_h1():
    """JCGM 100, H.1.5 and H.1.6: u_c 32 nm, 16 degrees of freedom, t_99 2.92, U_99 93 nm."""
    parts = [(25.0, 18), (9.7, 25.6), (2.9, 50), (16.6, 2)]
    sources = [Source(f"{u} nm", u * 1e-9, "m", degrees_of_freedom=v) for u, v in parts]
    found = budget(*sources, level=0.99)
    assert round(1e9 * found.std) == 32
    assert int(found.degrees_of_freedom) == 16
    assert round(found.factor, 2) == 2.92
    assert round(1e9 * found.expanded) == 93


@pytest.mark.parametrize(
    ("function", "printed"),
    [
        (lambda v, i, p: (np.cos(p) / i, -v * np.cos(p) / i**2, -v * np.sin(p) / i), 0.071),
        (lambda v, i, p: (np.sin(p) / i, -v * np.sin(p) / i**2, v * np.cos(p) / i), 0.295),
        (lambda v, i, p: (1 / i, -v / i**2, 0.0), 0.236),
    ],
    ids=["resistance", "reactance", "impedance"],
)
def test_correlated_readings_of_gum_h2(function, printed):
    """JCGM 100, H.2: five simultaneous readings of V, I and phase (Table H.2); u of Table H.3 in ohm."""
    data = np.array(
        [
            [5.007, 4.994, 5.005, 4.990, 4.999],
            [19.663e-3, 19.639e-3, 19.640e-3, 19.685e-3, 19.678e-3],
            [1.0456, 1.0438, 1.0468, 1.0428, 1.0433],
        ]
    )
    slopes = function(*data.mean(axis=1))
    sources = [
        Source.readings(name, row, "1", sensitivity=float(c))
        for name, row, c in zip("VIp", data, slopes, strict=True)
    ]
    found = Budget("Z", "1", tuple(sources), correlation=np.corrcoef(data))
    assert found.std == pytest.approx(printed, abs=1e-3)  # the GUM goes on from values rounded to 2 digits


# -- distributions ---------------------------------------------------------------------------------------

SHAPES = [
    ("rectangular", stats.uniform(-0.7, 1.4)),
    ("triangular", stats.triang(0.5, -0.7, 1.4)),
    ("arcsine", stats.arcsine(-0.7, 1.4)),
]


@pytest.mark.parametrize(("shape", "known"), SHAPES, ids=[shape for shape, _ in SHAPES])
def test_standard_uncertainty_and_draws_of_a_shape(shape, known):
    source = Source("a", 0.7 / DIVISORS[shape], "m", shape)
    assert source.std == pytest.approx(known.std(), rel=1e-12)
    drawn = source.draw(np.random.default_rng(1), 20_000)
    assert stats.kstest(drawn, known.cdf).pvalue > 1e-3


def test_readings_are_students():
    values = [1.0, 1.4, 0.7, 1.2]
    source = Source.readings("r", values, "m")
    assert source.std == pytest.approx(stats.sem(values), rel=1e-12)
    assert source.degrees_of_freedom == 3
    drawn = source.draw(np.random.default_rng(2), 20_000) / source.std
    assert stats.kstest(drawn, stats.t(3).cdf).pvalue > 1e-3
    low, high = stats.t.interval(0.95, 3, loc=0, scale=stats.sem(values))
    assert budget(source, level=0.95).expanded == pytest.approx((high - low) / 2, rel=1e-12)


# -- algebra ---------------------------------------------------------------------------------------------


@given(st.lists(st.tuples(SIZES, SLOPES), min_size=1, max_size=6), st.floats(1e-6, 1e6))
def test_independent_sources_add_in_quadrature_in_any_unit(parts, scale):
    sources = [Source(f"{k}", u, "m", sensitivity=c) for k, (u, c) in enumerate(parts)]
    found = budget(*sources)
    assert found.std == pytest.approx(float(np.linalg.norm([u * c for u, c in parts])), rel=1e-9, abs=1e-300)
    if found.std > 0:
        assert found.shares.sum() == pytest.approx(1.0, rel=1e-9)
        assert np.all(found.shares >= 0)
    other = [Source(s.name, s.std * scale, "m", sensitivity=s.sensitivity) for s in sources]
    assert budget(*other).std == pytest.approx(found.std * scale, rel=1e-9)
    assert budget(*sources[::-1]).std == pytest.approx(found.std, rel=1e-9)


@given(SIZES, SIZES)
def test_full_correlation_adds_and_cancels(a, b):
    pair = (Source("a", a, "m"), Source("b", b, "m"))
    for r, expected in ((1.0, a + b), (-1.0, abs(a - b)), (0.0, float(np.hypot(a, b)))):
        found = budget(*pair, correlation=np.array([[1.0, r], [r, 1.0]]))
        assert found.std == pytest.approx(expected, rel=1e-6, abs=1e-7 * max(a, b))


def test_effective_degrees_of_freedom():
    """JCGM 100, G.4: equal sources add their freedom; one that is stated adds infinitely much."""
    a, b = (Source(n, 1.0, "m", degrees_of_freedom=5) for n in "ab")
    assert budget(a).degrees_of_freedom == pytest.approx(5)
    assert budget(a, b).degrees_of_freedom == pytest.approx(10)
    assert budget(a, Source("c", 1.0, "m")).degrees_of_freedom == pytest.approx(20)
    assert budget(Source("c", 1.0, "m")).degrees_of_freedom == inf
    together = budget(a, b, correlation=np.array([[1, 0.5], [0.5, 1]]))
    assert together.degrees_of_freedom == pytest.approx(5)
    for freedom in (5, 5e9):  # many of them are not told
        said = budget(Source("a", 1.0, "m", degrees_of_freedom=freedom)).summary()
        assert ("effective degrees of freedom" in said) is (freedom == 5)


def test_the_factor_of_a_level_tends_to_the_normal_one():
    assert budget(Source("a", 1.0, "m"), level=0.95).factor == pytest.approx(1.959964, abs=1e-6)
    freedoms = [2, 5, 20, 1e5]
    factors = [budget(Source("a", 1.0, "m", degrees_of_freedom=v), level=0.95).factor for v in freedoms]
    assert factors == sorted(factors, reverse=True)
    assert factors[0] == pytest.approx(4.303, abs=1e-3)  # JCGM 100, Table G.2
    assert factors[1] == pytest.approx(2.571, abs=1e-3)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Source("a", -1.0, "m"), "must be a number >= 0"),
        (lambda: Source("a", 1.0, "m", "gauss"), "must be one of normal"),
        (lambda: Source("a", 1.0, "m", degrees_of_freedom=0), "must be 1 or more"),
        (lambda: Source.readings("a", [1.0], "m"), "two or more"),
        (lambda: budget(Source("a", 1.0, "m"), level=95), "between 0 and 1"),
        (
            lambda: budget(Source("a", 1, "m"), Source("b", 1, "m"), correlation=np.array([[1, 2], [2, 1]])),
            "can hold together",
        ),
    ],
)
def test_what_cannot_be_is_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
