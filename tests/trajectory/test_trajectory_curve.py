"""What a curve is: points, derivatives, length, extent, and the file it is kept in."""

import json
from pathlib import Path

import jsonschema
import numpy as np
import pytest
from cycloid import WHOLE, cycloid, through

import hallsym
from hallsym import InputError
from hallsym.trajectory import Curve, nominal, read_curve
from hallsym.trajectory.choose import METHODS, Target
from hallsym.trajectory.curve import FORMAT, FgForm
from hallsym.trajectory.factorisation import TRIGONOMETRIC, factorise

SCHEMA = Path(hallsym.__file__).parent / "trajectory/curve.schema.json"


@pytest.mark.parametrize("method", METHODS[:-3] + METHODS[-2:], ids=lambda m: m.name)
def test_derivatives(method):
    curve = Target(cycloid()).made(method, 12, 7)
    t, step = np.linspace(0.1, WHOLE - 0.1, 7) + 0.003, 1e-5
    one = (curve(t + step) - curve(t - step)) / (2 * step)
    assert curve(t, 1) == pytest.approx(one, abs=1e-11)
    two = (curve(t + step, 1) - curve(t - step, 1)) / (2 * step)
    assert curve(t, 2) == pytest.approx(two, abs=1e-9)


def test_a_circle_has_its_length_and_extent():
    circle = nominal("x = r*cos(t); y = r*sin(t)", ("t", "-pi/2", "pi/2"), {"r": 2e-3})
    t = np.linspace(-np.pi / 2, np.pi / 2, 3)
    curve = Curve(FgForm(TRIGONOMETRIC, factorise(TRIGONOMETRIC, t).solve(circle(t))), *t[[0, -1]])
    assert curve.length() == pytest.approx(2e-3 * np.pi, rel=1e-12)
    assert curve.extent()["x_m"] == pytest.approx((0.0, 2e-3), abs=1e-12)
    with pytest.raises(InputError, match="must be within"):
        curve(2.0)


@pytest.mark.parametrize("method", METHODS, ids=lambda m: m.name)
def test_json_gives_the_same_curve(method, tmp_path):
    curve = Target(cycloid()).made(method, 14, 7)
    curve.save(tmp_path / "curve.json")
    again, t = read_curve(tmp_path / "curve.json"), np.linspace(0, WHOLE, 50)
    assert np.array_equal(again(t), curve(t))
    assert again.to_dict() == curve.to_dict()
    raw = json.loads((tmp_path / "curve.json").read_text(encoding="utf-8"))
    jsonschema.validate(raw, json.loads(SCHEMA.read_text(encoding="utf-8")))


def test_files_that_are_no_curves(tmp_path):
    path = tmp_path / "curve.json"
    with pytest.raises(InputError, match="does not exist"):
        read_curve(path)
    good = through("bernstein", 5).to_dict()
    for broken in (
        "{", "[]", '{"format": "other"}', json.dumps(good | {"form": {"kind": "bernstein"}}),
        json.dumps(good | {"start": 3, "stop": 1}), json.dumps(good | {"coordinates": ["x_m"]}),
        json.dumps(good | {"form": {"kind": "spline", "degree": 3, "knots": [0, 1], "control": [[0, 0]]}}),
        json.dumps(good | {"form": {"kind": "spline", "degree": 1, "knots": [0, 0, None, 1],
                                    "control": [[0, 0], [1, 1]]}}),
        json.dumps(good | {"form": {"kind": "fourier", "control": [[0, 0]]}}), json.dumps({"format": FORMAT}),
    ):  # fmt: skip
        path.write_text(broken, encoding="utf-8")
        with pytest.raises(InputError, match=r"curve\.json|Basis"):
            read_curve(path)
