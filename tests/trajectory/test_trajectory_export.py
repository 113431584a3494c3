"""Curves as C, G-code and tables: what is written is the curve, within the error that is stated."""

import ctypes
import re
import shutil
import subprocess

import numpy as np
import pytest
from cycloid import WHOLE, cycloid, through

from hallsym import InputError
from hallsym.trajectory import Curve, nominal
from hallsym.trajectory.c_code import c_code
from hallsym.trajectory.export import at_times, chord_points, gcode, times, write_table
from hallsym.trajectory.methods import method_named
from hallsym.trajectory.polynomials import pieces_of
from hallsym.trajectory.target import Target

FLAGS = (
    "-std=c99",
    "-Wall",
    "-Wextra",
    "-Wconversion",
    "-Wdouble-promotion",
    "-Werror",
    "-O2",
    "-shared",
    "-fPIC",
)
CURVES = {
    "bernstein": ("bernstein", 12, "equidistant"), "chebyshev": ("chebyshev", 11, "chebyshev"),
    "linear": ("linear", 60, "equidistant"), "cubic": ("cubic", 49, "equidistant"),
    "septic": ("septic", 30, "equidistant"),
}  # fmt: skip


def compiled(curve, folder, name="curve", extra=()):
    code = c_code(curve, name)
    assert {path.name for path in code.save(folder / f"{name}.c")} == {f"{name}.c", f"{name}.h"}
    library = folder / f"{name}.so"
    subprocess.run(["gcc", *FLAGS, *extra, "-o", library, folder / f"{name}.c"], check=True)

    class Point(ctypes.Structure):
        _fields_ = [(c, ctypes.c_float) for c in curve.coordinates]

    function = getattr(ctypes.CDLL(str(library)), f"{name}_point")
    function.argtypes = [ctypes.c_float, ctypes.POINTER(Point)]
    return code, function, Point


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
@pytest.mark.parametrize("name", CURVES)
def test_c_stays_within_its_proved_error(name, tmp_path):
    curve = through(*CURVES[name])
    for extra in ((), ("-ffp-contract=off",)):
        code, function, point = compiled(curve, tmp_path, extra=extra)
        breaks = c_breaks(code.source)
        near = np.concatenate([np.nextafter(breaks, np.float32(side)) for side in (0, 1)])
        u = np.unique(
            np.r_[np.random.default_rng(0).uniform(size=3000), breaks, near, np.linspace(0, 1, 257)]
        )
        u = np.clip(u, 0, 1).astype(np.float32)
        out, found = point(), []
        for value in u.tolist():
            assert function(value, out) == 0
            found.append([getattr(out, c) for c in curve.coordinates])
        true = curve(curve.start + u.astype(float) * (curve.stop - curve.start))
        error = np.abs(np.array(found) - true).max(axis=0)
        assert (error <= list(code.error.values())).all()
        assert (error > 0.02 * np.array(list(code.error.values()))).any()  # the bound is of this size
        assert code.error_m < 1e-8
    before = out.x_m
    for outside in (-1e-6, 1.0000001, float("nan"), float("inf")):
        assert function(outside, out) == 1
        assert out.x_m == before
    assert "double" not in code.source.replace("-double", "")


def c_breaks(source: str) -> np.ndarray:
    text = re.search(r"breaks\[.*?\] = \{(.*?)\}", source, re.S)[1]
    return np.array([float(v.strip().rstrip("f")) for v in text.split(",")], np.float32)


def test_what_has_no_c():
    with pytest.raises(InputError, match="not made of polynomials"):
        c_code(through("trigonometric", 9))
    with pytest.raises(InputError, match="not made of polynomials"):
        c_code(through("aaa", 14))
    with pytest.raises(InputError, match="needs a name"):
        c_code(through("cubic", 9), "My curve")
    with pytest.raises(InputError, match="no Bernstein form"):
        c_code(through("chebyshev", 80, "chebyshev"))


@pytest.mark.parametrize("name", CURVES)
def test_pieces_are_the_curve(name):
    curve, t = through(*CURVES[name]), np.linspace(0, WHOLE, 999)
    pieces = pieces_of(curve)
    assert np.abs(pieces.evaluate(t) - curve(t)).max() <= max(pieces.error, 1e-17)
    assert pieces.error < 1e-14


@pytest.mark.parametrize("name", CURVES)
@pytest.mark.parametrize("chord", [1e-6, 1e-8])
def test_chords_stay_within_their_distance(name, chord):
    curve = through(*CURVES[name])
    t = chord_points(curve, chord)
    assert t[0] == curve.start
    assert t[-1] == curve.stop
    ends = curve(t)
    share = np.linspace(0, 1, 11)
    for k in range(0, len(t) - 1, max(len(t) // 60, 1)):
        way = ends[k + 1] - ends[k]
        between = curve(np.clip(t[k] + share * (t[k + 1] - t[k]), t[k], t[k + 1])) - ends[k]
        across = np.abs(between @ np.array([-way[1], way[0]])) / np.linalg.norm(way)
        assert across.max() <= chord * (1 + 1e-9)
    if name != "linear":
        assert len(t) < 3 * 256 + 20 * np.sqrt(8e-3 / chord)


def test_g1_blocks():
    text = gcode(through("bernstein", 12), chord_m=1e-7, feed_m_s=2e-3)
    moves = re.findall(r"^G1 X(\S+) Y(\S+)", text, re.M)
    assert "chords within 0.1 um of the curve" in text
    assert "F120" in text
    assert np.array(moves[-1], float) == pytest.approx([2 * np.pi, 0], abs=1e-6)
    assert all(line.count("(") <= 1 for line in text.splitlines())
    assert text.rstrip().endswith("M2")


def test_g5_blocks_are_the_cubic_spline():
    curve = through("cubic", 20)
    text = gcode(curve)
    start = np.array(re.search(r"G0 X(\S+) Y(\S+)", text).groups(), float)
    blocks = re.findall(r"^G5 I(\S+) J(\S+) P(\S+) Q(\S+) X(\S+) Y(\S+)", text, re.M)
    edges, s = curve.parts(1), np.linspace(0, 1, 9)[:, None]
    assert len(blocks) == len(edges) - 1
    for k, block in enumerate(np.array(blocks, float)):
        end = block[4:]
        b = [start, start + block[:2], end + block[2:4], end]
        ours = (1 - s) ** 3 * b[0] + 3 * s * (1 - s) ** 2 * b[1] + 3 * s**2 * (1 - s) * b[2] + s**3 * b[3]
        true = 1e3 * curve(edges[k] + s[:, 0] * (edges[k + 1] - edges[k]))
        assert np.abs(ours - true).max() < 2e-6  # mm: rounding to 1 nm
        start = end


def test_g5_2_blocks_are_the_control_points():
    curve = through("bernstein", 8)
    text = gcode(curve)
    assert "G5.2 P1 L8" in text
    assert "G5.3" in text
    first = re.search(r"G0 X(\S+) Y(\S+)", text).groups()
    rest = re.findall(r"^X(\S+) Y(\S+) P1", text, re.M)
    assert np.array([first, *rest], float) == pytest.approx(1e3 * curve.form.control, abs=6e-7)


def test_what_has_no_g_code():
    with pytest.raises(InputError, match="degree 5 has no G-code block"):
        gcode(through("quintic", 12))
    with pytest.raises(InputError, match="not made of polynomials"):
        gcode(through("trigonometric", 9))
    with pytest.raises(InputError, match=r"has no derivatives|not made of polynomials"):
        gcode(through("aaa", 14), chord_m=1e-7)
    with pytest.raises(InputError, match="blocks; at most"):
        gcode(through("cubic", 12), chord_m=1e-18)
    with pytest.raises(InputError, match="positive length"):
        gcode(through("cubic", 12), chord_m=-1.0)
    turning = nominal("x = t; rz = t", ("t", "0", "1"))
    line = Target(turning).made(method_named("linear"), "equidistant", 2, 0)
    assert "rz_rad cannot be written" in gcode(line)
    assert "G1 X1000.000000" in gcode(line)


def test_a_table_at_a_clock(tmp_path):
    curve = through("bernstein", 12)
    assert write_table(curve, tmp_path / "a.csv", duration_s=1.0, step_s=0.25) == 5
    rows = np.loadtxt(tmp_path / "a.csv", delimiter=",", skiprows=1)
    assert rows[:, 0].tolist() == [0, 0.25, 0.5, 0.75, 1.0]
    assert rows[:, 1:] == pytest.approx(curve(np.linspace(0, WHOLE, 5)))
    assert times(1.0, 0.3).tolist() == pytest.approx([0, 0.3, 0.6, 0.9, 1.0])
    assert len(times(0.3, 0.1)) == 4
    with pytest.raises(InputError, match="rows"):
        times(1.0, 1e-9)


def test_at_constant_speed_equal_times_are_equal_ways():
    curve = through("chebyshev", 21, "chebyshev")
    t = np.linspace(0, 2, 41)
    found = at_times(curve, t, 2.0, steady=True)
    step = np.hypot(np.diff(found["x_m"]), np.diff(found["y_m"]))
    assert step == pytest.approx(np.full(40, 8e-3 / 40), rel=5e-3)  # chords
    assert not found["rz_rad"].any()
    waits = at_times(curve, np.array([-1.0, 3.0]), 2.0)
    assert waits["x_m"] == pytest.approx([0, 2e-3 * np.pi], abs=1e-12)
    with pytest.raises(InputError, match="positive number of seconds"):
        at_times(curve, t, 0.0)


def test_an_angle_comes_with_the_path():
    text = nominal("x = r*t; y = r*t; rz = t/1000", ("t", "0", "1"), {"r": 1e-3})
    curve = Target(text).made(method_named("bernstein"), "equidistant", 3, 0)
    assert isinstance(curve, Curve)
    assert at_times(curve, np.array([0.5]), 1.0)["rz_rad"] == pytest.approx([5e-4])
    assert cycloid().coordinates == ("x_m", "y_m")
