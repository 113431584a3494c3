"""Runs that follow a curve: where they are at which time, how a campaign file says it, what is refused."""

import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.simulation import follow, read_campaign, write_campaign
from hallsym.trajectory import Curve, choose_curve

CIRCLE = "x = r*cos(t); y = r*sin(t)"
DURATION = 2.0
T = np.linspace(0.0, DURATION, 401)


@pytest.fixture(scope="module")
def circle() -> Curve:
    """A closed circle of 0.2 mm about 0."""
    return choose_curve(CIRCLE, 1e-10, span="t=0:2*pi", values={"r": 2e-4}, method="quintic").curve


@pytest.fixture(scope="module")
def uneven() -> Curve:
    """A line of 0.4 mm whose parameter runs slowly at first."""
    return choose_curve("x = r*t**2", 1e-12, span="t=0:1", values={"r": 4e-4}, method="bernstein").curve


def angle_of(curve: Curve) -> np.ndarray:
    found = follow(curve, DURATION)
    return np.arctan2(found["y_m"](T), found["x_m"](T))


def test_a_curve_is_followed_once(circle):
    turn = 2 * np.pi * T / DURATION
    assert np.allclose(np.exp(1j * angle_of(circle)), np.exp(1j * turn), atol=1e-6)


def test_the_parameter_runs_evenly(uneven):
    slow = follow(uneven, DURATION)["x_m"](T)
    assert np.allclose(slow, 4e-4 * (T / DURATION) ** 2, atol=1e-12)


def test_a_run_stands_at_the_end_of_its_curve_after_its_time(uneven):
    assert follow(uneven, DURATION)["x_m"](np.array([5.0])) == pytest.approx([4e-4])


CAMPAIGN = """
step_s = 0.01

[[setting]]
z_m = 1e-4

[[trajectory]]
duration_s = 0.5
curve = "circle.json"

[[run]]
duration_s = 2.0
curve = "circle.json"
x_m = 1e-4
rz_rad = { kind = "sine", amplitude = 1e-4, frequency_hz = 1.0 }
"""


def test_a_campaign_file_names_curves_of_its_own_folder(circle, tmp_path, monkeypatch):
    folder = tmp_path / "lab"
    folder.mkdir()
    circle.save(folder / "circle.json")
    (folder / "c.toml").write_text(CAMPAIGN, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    campaign = read_campaign("lab/c.toml")
    first, second = campaign.runs
    assert first.position("x_m", np.zeros(1)) == pytest.approx([2e-4], abs=1e-9)
    assert first.position("z_m", np.zeros(1)) == [1e-4]
    assert second.position("x_m", np.zeros(1)) == pytest.approx([3e-4], abs=1e-9)  # about its place
    with pytest.raises(InputError, match="is not written"):
        write_campaign(campaign, tmp_path / "again.toml")


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ('curve = "none.json"', "does not exist"),
        ("curve = 3", "must be text"),
        ('curve = "circle.json"\nx_m = { kind = "sine", amplitude = 1e-4, frequency_hz = 1.0 }', "keep one"),
    ],
)
def test_bad_curves_of_a_campaign_are_one_sentence(circle, uneven, tmp_path, line, sentence):
    circle.save(tmp_path / "circle.json")
    uneven.save(tmp_path / "line.json")
    (tmp_path / "c.toml").write_text(f"[[run]]\nduration_s = 1.0\n{line}\n", encoding="utf-8")
    with pytest.raises(InputError, match=sentence):
        read_campaign(tmp_path / "c.toml")
