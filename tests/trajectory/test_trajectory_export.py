"""Curves as G-code and tables: what is written is the curve, within the error that is stated."""

import re

import numpy as np
import pytest
from cycloid import WHOLE, cycloid, through

from hallsym import InputError
from hallsym.trajectory import nominal
from hallsym.trajectory.choose import Target, method_named
from hallsym.trajectory.export import at_times, chord_points, gcode, times, write_table

CURVES = {
    "bernstein": ("bernstein", 12), "trigonometric": ("trigonometric", 15), "linear": ("linear", 60),
    "cubic": ("cubic", 49), "quintic": ("quintic", 30),
}  # fmt: skip


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
    text = gcode(through("bernstein", 12), chord_m=1e-7, duration_s=4.0)
    moves = re.findall(r"^G1 X(\S+) Y(\S+)", text, re.M)
    assert "chords within 0.1 um of the curve" in text
    assert "F120" in text
    assert np.array(moves[-1], float) == pytest.approx([2 * np.pi, 0], abs=1e-6)
    assert all(line.count("(") <= 1 for line in text.splitlines())
    assert text.rstrip().endswith("M2")


def test_what_has_no_g_code():
    with pytest.raises(InputError, match="blocks; at most"):
        gcode(through("cubic", 12), chord_m=1e-18)
    with pytest.raises(InputError, match="positive length"):
        gcode(through("cubic", 12), chord_m=-1.0)
    turning = nominal("x = t; rz = t", ("t", "0", "1"))
    line = Target(turning).made(method_named("linear"), 2, 0)
    assert "rz_rad cannot be written" in gcode(line, chord_m=1e-6)
    assert "G1 X1000.000000" in gcode(line, chord_m=1e-6)


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


def test_a_curve_waits_before_and_after_its_time():
    curve = through("bernstein-chebyshev", 21)
    waits = at_times(curve, np.array([-1.0, 3.0]), 2.0)
    assert waits["x_m"] == pytest.approx([0, 2e-3 * np.pi], abs=1e-12)
    with pytest.raises(InputError, match="positive number of seconds"):
        at_times(curve, np.zeros(1), 0.0)


def test_an_angle_comes_with_the_path():
    text = nominal("x = r*t; y = r*t; rz = t/1000", ("t", "0", "1"), {"r": 1e-3})
    curve = Target(text).made(method_named("bernstein"), 3, 0)
    assert at_times(curve, np.array([0.5]), 1.0)["rz_rad"] == pytest.approx([5e-4])
    assert cycloid().coordinates == ("x_m", "y_m")
