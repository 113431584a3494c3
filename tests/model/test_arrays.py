"""CasADi functions on whole arrays give what CasADi itself gives, sample by sample."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.model import arrays, on_arrays

EPS = float(np.finfo(float).eps)
ULPS = 4 * EPS
"""libm and numpy round their transcendental functions differently, by less than 4 units in the last place."""

WIDE = (-3.0, 3.0)
POSITIVE = (1e-3, 3.0)
SMALL = (-0.999, 0.999)
UNARY = {
    ca.OP_NEG: (WIDE, lambda a: -a),
    ca.OP_EXP: (WIDE, ca.exp),
    ca.OP_LOG: (POSITIVE, ca.log),
    ca.OP_SQRT: (POSITIVE, ca.sqrt),
    ca.OP_SQ: (WIDE, lambda a: a**2),
    ca.OP_TWICE: (WIDE, lambda a: 2 * a),
    ca.OP_SIN: (WIDE, ca.sin),
    ca.OP_COS: (WIDE, ca.cos),
    ca.OP_TAN: (SMALL, ca.tan),
    ca.OP_ASIN: (SMALL, ca.asin),
    ca.OP_ACOS: (SMALL, ca.acos),
    ca.OP_ATAN: (WIDE, ca.atan),
    ca.OP_SINH: (WIDE, ca.sinh),
    ca.OP_COSH: (WIDE, ca.cosh),
    ca.OP_TANH: (WIDE, ca.tanh),
    ca.OP_FABS: (WIDE, ca.fabs),
    ca.OP_SIGN: (WIDE, ca.sign),
    ca.OP_FLOOR: (WIDE, ca.floor),
    ca.OP_CEIL: (WIDE, ca.ceil),
    ca.OP_INV: (POSITIVE, lambda a: 1 / a),
    ca.OP_NOT: (WIDE, ca.logic_not),
}
BINARY = {
    ca.OP_ADD: (WIDE, lambda a, b: a + b),
    ca.OP_SUB: (WIDE, lambda a, b: a - b),
    ca.OP_MUL: (WIDE, lambda a, b: a * b),
    ca.OP_DIV: (POSITIVE, lambda a, b: a / b),
    ca.OP_POW: (POSITIVE, lambda a, b: a**b),
    ca.OP_CONSTPOW: (POSITIVE, lambda a, b: a**3.7),
    ca.OP_ATAN2: (WIDE, ca.atan2),
    ca.OP_HYPOT: (WIDE, ca.hypot),
    ca.OP_FMIN: (WIDE, ca.fmin),
    ca.OP_FMAX: (WIDE, ca.fmax),
    ca.OP_FMOD: (POSITIVE, ca.fmod),
    ca.OP_COPYSIGN: (WIDE, ca.copysign),
    ca.OP_LT: (WIDE, lambda a, b: a < b),
    ca.OP_LE: (WIDE, lambda a, b: a <= b),
    ca.OP_EQ: (WIDE, lambda a, b: a == b),
    ca.OP_NE: (WIDE, lambda a, b: a != b),
    ca.OP_AND: (WIDE, ca.logic_and),
    ca.OP_OR: (WIDE, ca.logic_or),
    ca.OP_IF_ELSE_ZERO: (WIDE, lambda a, b: ca.if_else(a, b, 0)),
}
BY_SAMPLE = {ca.OP_ASSIGN}
"""Makes no instruction of its own in a scalar graph."""


def codes(function: ca.Function) -> set[int]:
    return {function.instruction_id(k) for k in range(function.n_instructions())}


def points(low: float, high: float) -> np.ndarray:
    """Random points, with zeros, whole numbers and equal pairs where the range has them."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(low, high, (2, 200))
    if low < 0:
        x[:4], y[:4] = [0.0, 0.0, 1.0, -1.0], [0.0, 2.0, 0.0, -1.0]
    x[10:20] = y[10:20]
    return np.clip(np.array([x, y]), low, high)


def test_the_table_of_operations_is_tested_whole():
    assert set(arrays.UNARY) == set(UNARY) | BY_SAMPLE
    assert set(arrays.BINARY) == set(BINARY)


@pytest.mark.parametrize("code", sorted(UNARY) + sorted(BINARY))
def test_every_operation_is_casadis(code):
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    (low, high), make = (UNARY | BINARY)[code]
    expression = make(a) if code in UNARY else make(a, b)
    function = ca.Function("f", [ca.vertcat(a, b)], [ca.densify(expression)])
    assert code in codes(function)
    samples = points(low, high)
    (found,) = on_arrays(function)(samples)
    expected = np.array([float(function(sample)) for sample in samples.T])
    assert found.shape == (1, samples.shape[1])
    assert np.all(np.abs(found[0] - expected) <= ULPS * np.maximum(np.abs(expected), EPS))


@pytest.mark.parametrize("shared", [False, True])
def test_a_jacobian_takes_the_mode_of_fewer_operations(shared):
    p, x = ca.SX.sym("p", 4), ca.SX.sym("x", 12)
    one, own = ca.exp(ca.sin(ca.sumsqr(p))), [ca.exp(ca.sin(ca.sumsqr(p * a))) for a in ca.vertsplit(x)]
    values = one * x if shared else ca.vertcat(*own)
    found, usual = (ca.Function("f", [p, x], [of(values, p)]) for of in (arrays.jacobian, ca.jacobian))
    at = np.arange(4) / 9, np.arange(12) / 9
    assert np.allclose(found(*at).full(), usual(*at).full(), rtol=1e-13)
    assert (found.n_instructions() < usual.n_instructions()) == (not shared)


def test_sign_of_negative_numbers_in_fmod_and_of_zero():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    f = on_arrays(ca.Function("f", [ca.vertcat(a, b)], [ca.vertcat(ca.fmod(a, b), ca.sign(a))]))
    assert f(np.array([[-5.5, 5.5, 0.0], [2.0, -2.0, 1.0]]))[0].tolist() == [
        [-1.5, 1.5, 0.0],
        [-1.0, 1.0, 0.0],
    ]


@pytest.mark.parametrize("make", [ca.erf, ca.asinh, ca.log1p, lambda a: ca.remainder(a, 2.0)])
def test_an_operation_without_array_form_raises_at_once(make):
    a = ca.SX.sym("a")
    with pytest.raises(NotImplementedError, match="no array form"):
        on_arrays(ca.Function("f", [a], [make(a)]))


def test_sparse_outputs_raise_at_once():
    a = ca.SX.sym("a")
    with pytest.raises(NotImplementedError, match="densify"):
        on_arrays(ca.Function("f", [a], [ca.vertcat(a, ca.SX(1, 1))]))


@settings(max_examples=25)
@given(st.lists(st.integers(1, 4), min_size=0, max_size=3), st.integers(0, 3))
def test_scalars_and_arrays_broadcast(shape, drop):
    """x of the full shape, y of its trailing axes, a number: as numpy broadcasts them."""
    x, y, z = (ca.SX.sym(n) for n in "xyz")
    run = on_arrays(ca.Function("f", [ca.vertcat(x, y), z], [ca.vertcat(x * y + z, z), ca.densify(ca.SX(7))]))
    rng = np.random.default_rng(1)
    full, tail = rng.normal(size=shape), rng.normal(size=shape[min(drop, len(shape)) :])
    first, second = run([full, tail], [2.5])
    assert first.shape == (2, *shape)
    assert second.shape == (1, *shape)
    assert np.array_equal(first[0], full * tail + 2.5)
    assert np.all(first[1] == 2.5)
    assert np.all(second == 7.0)


def test_matrices_come_column_by_column():
    x = ca.SX.sym("x", 2)
    (flat,) = on_arrays(ca.Function("f", [x], [ca.densify(ca.horzcat(x, 10 * x))]))(
        [1.0, np.array([2.0, 3.0])]
    )
    assert flat.tolist() == [[1, 1], [2, 3], [10, 10], [20, 30]]


def test_inputs_are_left_as_they_are():
    x = ca.SX.sym("x")
    given_, f = np.array([1.0, 2.0]), on_arrays(ca.Function("f", [x], [x]))
    (out,) = f([given_])
    out += 1.0
    assert given_.tolist() == [1.0, 2.0]


def test_many_samples_go_through_in_pieces(monkeypatch):
    """Memory does not grow with samples times intermediate values; the values are the same, bit by bit."""
    x, p = ca.SX.sym("x", 2), ca.SX.sym("p")
    f = ca.Function("f", [p, x], [ca.vertcat(ca.sin(x[0]) * p, x[1] ** 2), ca.SX(3)])
    samples = np.random.default_rng(0).standard_normal((2, 1001))
    whole = on_arrays(f)([2.0], samples)
    monkeypatch.setattr(arrays, "WORK", 1)
    monkeypatch.setattr(arrays, "FEWEST", 100)
    parts, table = on_arrays(f)([2.0], samples), samples.reshape(2, 143, 7)
    rows = on_arrays(f)([np.full((143, 1), 2.0)], table)  # a parameter of each row: one of its axes is 1
    for one, row, other in zip(parts, rows, whole, strict=True):
        np.testing.assert_array_equal(one, other, strict=True)
        np.testing.assert_array_equal(row.reshape(-1, 1001), other, strict=True)
