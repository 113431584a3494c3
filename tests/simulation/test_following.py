"""Runs that follow a curve: where they are at which time, how a campaign file says it, what is refused."""

import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.families import build
from hallsym.simulation import Campaign, Following, Run, follow, read_campaign, simulate, write_campaign
from hallsym.trajectory import Curve, choose_curve, points_of

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


def angle_of(curve: Curve, **how) -> np.ndarray:
    found = follow(curve, DURATION, **how)
    return np.arctan2(found["y_m"](T), found["x_m"](T))


def near(a: np.ndarray, b: np.ndarray) -> bool:
    return bool(np.allclose(np.exp(1j * a), np.exp(1j * b), atol=1e-6))


def test_a_curve_is_followed_forward_backward_and_there_and_back(circle):
    turn = 2 * np.pi * T / DURATION
    assert near(angle_of(circle), turn)
    assert near(angle_of(circle, direction="backward"), -turn)
    assert near(angle_of(circle, times=3), 3 * turn)
    there_and_back = np.pi * (1 - np.abs(1 - 2 * T / DURATION)) * 2
    assert near(angle_of(circle, direction="both"), there_and_back)


def test_at_constant_speed_equal_times_are_equal_lengths(uneven):
    even = follow(uneven, DURATION, speed="constant")["x_m"](T)
    assert np.allclose(even, 4e-4 * T / DURATION, atol=1e-12)
    slow = follow(uneven, DURATION)["x_m"](T)
    assert np.allclose(slow, 4e-4 * (T / DURATION) ** 2, atol=1e-12)


def test_a_run_stands_at_the_end_of_its_curve_after_its_time(uneven):
    assert follow(uneven, DURATION)["x_m"](np.array([5.0])) == pytest.approx([4e-4])


def test_how_often_it_turns_is_known(circle, uneven):
    assert Following(circle, DURATION, times=6).fastest_hz == pytest.approx(3.0)
    assert Following(uneven, DURATION, direction="both").fastest_hz == pytest.approx(0.5)


CAMPAIGN = """
step_s = 0.01

[[setting]]
z_m = 1e-4

[[trajectory]]
duration_s = 0.5
curve = "circle.json"

[[run]]
duration_s = 2.0
curve = { file = "circle.json", direction = "backward", speed = "constant", times = 3 }
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
    write_campaign(campaign, tmp_path / "again.toml")
    assert sorted(p.name for p in tmp_path.glob("*.json")) == ["again_circle.json"]
    again = read_campaign(tmp_path / "again.toml")
    assert [dict(run.motion) for run in again.runs] == [dict(run.motion) for run in campaign.runs]
    assert [run.follows for run in again.runs] == [run.follows for run in campaign.runs]
    write_campaign(again, tmp_path / "again.toml")
    assert sorted(p.name for p in tmp_path.glob("*.json")) == ["again_circle.json"]


def test_different_curves_of_one_name_have_files_of_their_own(circle, uneven, tmp_path):
    runs = tuple(Run(1.0, {}, Following(c, 1.0, name="same").signals()) for c in (circle, uneven, circle))
    write_campaign(Campaign(0.01, runs), tmp_path / "c.toml")
    assert sorted(p.name for p in tmp_path.glob("*.json")) == ["c_same.json", "c_same_2.json"]
    assert [r.follows for r in read_campaign(tmp_path / "c.toml").runs] == [r.follows for r in runs]


def test_a_simulated_log_follows_the_curve(circle):
    model = build("stage31")
    columns = simulate(model, {}, Campaign(0.01, (Run(1.0, {}, follow(circle, 1.0)),)), seed=0)
    assert np.allclose(np.hypot(columns["x_ref_m"], columns["y_ref_m"]), 2e-4, atol=1e-9)


@pytest.mark.parametrize(
    ("line", "sentence"),
    [
        ('curve = "none.json"', "does not exist"),
        ("curve = 3", "must be a file"),
        ('curve = { file = "circle.json", direction = "left" }', "must be one of forward, backward, both"),
        ('curve = { file = "circle.json", pace = 1 }', "known are file, direction, speed, times"),
        ('curve = { file = "circle.json", times = 0 }', "1 or more"),
        ('curve = { file = "line.json", times = 2 }', "is not closed"),
        ('curve = "circle.json"\nx_m = { kind = "sine", amplitude = 1e-4, frequency_hz = 1.0 }', "keep one"),
    ],
)
def test_bad_curves_of_a_campaign_are_one_sentence(circle, uneven, tmp_path, line, sentence):
    circle.save(tmp_path / "circle.json")
    uneven.save(tmp_path / "line.json")
    (tmp_path / "c.toml").write_text(f"[[run]]\nduration_s = 1.0\n{line}\n", encoding="utf-8")
    with pytest.raises(InputError, match=sentence) as caught:
        read_campaign(tmp_path / "c.toml")
    assert "\n" not in str(caught.value)


def test_two_curves_in_a_run_are_not_written(circle, tmp_path):
    square = 1e-4 * np.array([[0.0, 0.0], [1.0, 1.0], [0.0, 2.0], [-1.0, 1.0], [0.0, 0.0]])
    turn = choose_curve(points_of(square), method="cubic").curve
    motion = {"x_m": follow(circle, 1.0)["x_m"], "y_m": follow(turn, 1.0)["y_m"]}
    with pytest.raises(InputError, match="follows two curves"):
        write_campaign(Campaign(0.01, (Run(1.0, {}, motion),)), tmp_path / "c.toml")
