"""Two paths by points within their tolerances: a spiral and a raster."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from hallsym import InputError
from hallsym.trajectory import choose_curve, read_points
from hallsym.trajectory.points import points_of

DATA = Path(__file__).parents[2] / "data/trajectories"


def test_a_spiral_of_200_points():
    points = read_points(DATA / "spiral.csv")
    assert len(points.t) == 200
    choice = choose_curve(points)
    assert choice.curve.error_kind == "at the points"
    assert choice.best.error_m < 1e-15
    t = np.linspace(0, 6 * np.pi, 5001)
    r = 1e-3 + 0.8e-3 * t / (2 * np.pi)
    true = np.column_stack([r * np.cos(t), r * np.sin(t)])
    assert np.linalg.norm(choice.curve(np.clip(t, *points.t[[0, -1]])) - true, axis=1).max() <= 0.05e-6


def test_a_raster_with_rounded_corners():
    points = read_points(DATA / "raster.csv")
    curve = choose_curve(points).curve
    s = np.linspace(*points.t[[0, -1]], 20001)
    true = raster(1e-3 * np.linspace(0, 40 + 3 * np.pi, 200_001))
    distance, _ = cKDTree(true).query(curve(s))
    assert distance.max() <= 1e-6
    assert curve.length() == pytest.approx(1e-3 * (40 + 3 * np.pi), rel=1e-6)


def raster(s: np.ndarray) -> np.ndarray:
    """Four lines of 10 mm joined by half circles of 1 mm radius, at lengths of path."""
    line, arc = 10e-3, np.pi * 1e-3
    row = np.minimum(s // (line + arc), 3)
    rest = s - row * (line + arc)
    angle = np.clip((rest - line) / 1e-3, 0, np.pi)
    x = np.minimum(rest, line) + 1e-3 * np.sin(angle)
    return np.column_stack([np.where(row % 2 == 0, x, line - x), 2e-3 * row + 1e-3 * (1 - np.cos(angle))])


def test_bad_points(tmp_path):
    def said(text: str) -> str:
        (tmp_path / "p.csv").write_text(text, encoding="utf-8")
        with pytest.raises(InputError) as caught:
            read_points(tmp_path / "p.csv")
        return str(caught.value)

    assert "number 3 (1) repeats number 2" in said("t,x_um,y_um\n0,0,0\n1,1,1\n1,2,2\n")
    assert "number 3 (1) is less than number 2 (2)" in said("t,x_um,y_um\n0,0,0\n2,1,1\n1,2,2\n")
    assert "Points 2 and 3 of p.csv are the same" in said("x_um,y_um\n0,0\n2,1\n2,1\n")
    assert "Point 2 of" in said("x_um,y_um\n0,0\n2,nan\n2,1\n")
    assert "must be t, or one of" in said("x,y_um\n0,0\n2,3\n2,1\n")
    assert "at least 2 rows" in said("x_um,y_um\n0,0\n")
    assert "at least one of the columns" in said("t,rz_urad\n0,0\n1,1\n")
    assert "a column twice" in said("x_um,x_mm\n0,0\n1,1\n")
    assert "must have 2 cells" in said("x_um,y_um\n0,0\n1,1,1\n")
    assert "must be a number; it is 'abc'" in said("x_um,y_um\n0,0\n1,abc\n")
    with pytest.raises(InputError, match="does not exist"):
        read_points(tmp_path / "none.csv")
    with pytest.raises(InputError, match="one finite number for each"):
        points_of(np.eye(2), np.zeros(3))
