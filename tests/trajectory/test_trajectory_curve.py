"""What a curve is: points, derivatives, length, curvature, extent, and the file it is kept in."""

import json
from pathlib import Path

import numpy as np
import pytest
from cycloid import WHOLE, cycloid, through
from hypothesis import given, settings
from hypothesis import strategies as st

import hallsym
from hallsym import InputError
from hallsym.trajectory import BERNSTEIN, Curve, factorise, nominal, read_curve, trigonometric
from hallsym.trajectory.corner_cutting import FgForm
from hallsym.trajectory.curve import FORMAT
from hallsym.trajectory.forms import SplineForm
from hallsym.trajectory.methods import METHODS, method_named
from hallsym.trajectory.target import Target

SCHEMA = Path(hallsym.__file__).parent / "trajectory/curve.schema.json"
SMOOTH = [method for method in METHODS if method.name != "aaa"]


def de_casteljau(f, g, control):
    """Every point at every parameter, without the basis."""
    p = np.repeat(control[:, None, :], len(f), axis=1)
    while len(p) > 1:
        p = g[:, None] * p[:-1] + f[:, None] * p[1:]
    return p[0]


@settings(max_examples=30)
@given(st.integers(0, 25), st.integers(1, 3), st.integers(0, 10**6))
def test_corner_cutting_is_de_casteljau(order, d, seed):
    control = np.random.default_rng(seed).normal(size=(order + 1, d))
    for basis in (BERNSTEIN, trigonometric(1.0)):
        t = np.linspace(basis.start, basis.stop, 33)
        form = FgForm(basis, control)
        scale = np.abs(control).max() * basis.largest(order)
        assert np.abs(form.evaluate(t) - de_casteljau(basis.f(t), basis.g(t), control)).max() <= 4e-15 * scale


def test_corner_cutting_at_order_1000_stays_between_the_control_points():
    control = np.random.default_rng(0).uniform(1, 2, (1001, 1))
    p = FgForm(BERNSTEIN, control).evaluate(np.r_[0.0, 1e-300, 1e-9, np.linspace(0, 1, 1001), 1 - 1e-16])
    assert p.min() >= 1
    assert p.max() <= 2
    assert p[0, 0] == control[0, 0]
    assert p[-2, 0] == control[-1, 0]


@pytest.mark.parametrize("method", SMOOTH, ids=lambda m: m.name)
def test_derivatives(method):
    curve = Target(cycloid()).made(method, method.nodes[0], 12, 7)
    t, step = np.linspace(0.1, WHOLE - 0.1, 7) + 0.003, 1e-5
    one = (curve(t + step) - curve(t - step)) / (2 * step)
    assert curve(t, 1) == pytest.approx(one, abs=1e-11)
    two = (curve(t + step, 1) - curve(t - step, 1)) / (2 * step)
    assert curve(t, 2) == pytest.approx(two, abs=1e-9)


def test_a_circle_has_its_length_curvature_and_extent():
    circle = nominal("x = r*cos(t); y = r*sin(t)", ("t", "-pi/2", "pi/2"), {"r": 2e-3})
    t = np.linspace(-np.pi / 2, np.pi / 2, 3)
    curve = Curve(FgForm(trigonometric(), factorise(trigonometric(), t).solve(circle(t))), *t[[0, -1]])
    assert curve.length() == pytest.approx(2e-3 * np.pi, rel=1e-12)
    assert curve.curvature(np.linspace(-1, 1, 9)) == pytest.approx(np.full(9, 500.0), rel=1e-9)
    assert curve.extent()["x_m"] == pytest.approx((0.0, 2e-3), abs=1e-12)
    assert curve.at_length(2e-3 * np.array([0.5, 1.7])) == pytest.approx(
        np.array([0.5, 1.7]) - np.pi / 2, abs=1e-9
    )
    with pytest.raises(InputError, match="must be within"):
        curve(2.0)


def test_the_cycloid_is_eight_radii_long_and_has_cusps():
    curve = through("chebyshev", 21, "chebyshev")
    assert curve.length() == pytest.approx(8e-3, rel=1e-8)
    assert curve.at_length(4e-3) == pytest.approx(np.array([np.pi]), abs=1e-6)
    assert curve.curvature(np.pi) == pytest.approx(np.array([250.0]), rel=1e-6)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_json_gives_the_same_curve(method, tmp_path):
    curve = Target(cycloid()).made(method, method.nodes[0], 14, 7)
    curve.save(tmp_path / "curve.json")
    again, t = read_curve(tmp_path / "curve.json"), np.linspace(0, WHOLE, 50)
    assert np.array_equal(again(t), curve(t))
    assert again.to_dict() == curve.to_dict()
    raw = json.loads((tmp_path / "curve.json").read_text(encoding="utf-8"))
    fits(raw, json.loads(SCHEMA.read_text(encoding="utf-8")))


def fits(value, schema) -> None:
    """Check a value against the parts of JSON Schema that the file uses."""
    kinds = {"object": (dict,), "array": (list,), "string": (str,), "number": (int, float), "integer": (int,)}
    if "oneOf" in schema:
        assert sum(_fits(value, one) for one in schema["oneOf"]) == 1, value
    if "const" in schema:
        assert value == schema["const"]
    if "enum" in schema:
        assert value in schema["enum"]
    if "type" in schema:
        names = [schema["type"]] if isinstance(schema["type"], str) else schema["type"]
        assert (
            value is None
            if "null" in names and value is None
            else isinstance(value, sum((kinds[name] for name in names if name != "null"), ()))
        )
    for key in schema.get("required", ()):
        assert key in value
    if "properties" in schema and schema.get("additionalProperties", True) is False:
        assert set(value) <= set(schema["properties"])
    for key, part in schema.get("properties", {}).items():
        if key in value:
            fits(value[key], part)
    for item in value if "items" in schema else ():
        fits(item, schema["items"])


def _fits(value, schema) -> bool:
    try:
        fits(value, schema)
    except AssertionError:
        return False
    return True


def test_files_that_are_no_curves(tmp_path):
    path = tmp_path / "curve.json"
    with pytest.raises(InputError, match="does not exist"):
        read_curve(path)
    good = through("bernstein", 5).to_dict()
    for broken in (
        "{", "[]", '{"format": "other"}', json.dumps(good | {"form": {"kind": "bernstein"}}),
        json.dumps(good | {"start": 3, "stop": 1}), json.dumps(good | {"coordinates": ["x_m"]}),
        json.dumps(good | {"form": {"kind": "spline", "degree": 3, "knots": [0, 1], "control": [[0, 0]]}}),
        json.dumps(good | {"form": {"kind": "fourier", "control": [[0, 0]]}}), json.dumps({"format": FORMAT}),
    ):  # fmt: skip
        path.write_text(broken, encoding="utf-8")
        with pytest.raises(InputError, match=r"curve\.json|Basis"):
            read_curve(path)


def test_public_names():
    assert hallsym.Curve is Curve
    assert hallsym.read_curve is read_curve
    choice = hallsym.choose_curve("x = r*t; y = r*t**2", 1e-9, span="t=0:1", values={"r": 1e-3})
    assert choice.curve.control_points == 3
    rng = np.linspace(0, 1, 30)
    by_points = hallsym.choose_curve(np.column_stack([np.cos(rng), np.sin(rng)]) * 1e-3, method="quintic")
    assert by_points.best.error_m < 1e-9
    assert not hasattr(hallsym, "nothing")


def test_a_spline_derived_past_its_degree_is_zero():
    found = method_named("cubic").make(np.linspace(0, 1, 9), np.random.default_rng(0).normal(size=(9, 2)), 0)
    assert isinstance(found, SplineForm)
    for _ in range(4):
        found = found.derivative()
    assert not found.evaluate(np.linspace(0, 1, 5)).any()
