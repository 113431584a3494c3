"""`hallsym budget` end to end: a budget file, a calibration, a log; one sentence for what cannot be."""

import json
from pathlib import Path

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.estimation import Fit, load_fit
from hallsym.log import Noise
from hallsym.report.drawing import draw
from hallsym.report.results.budget import PALEST, budget_bars, position_words, uncertainty_picture
from hallsym.uncertainty import Settings, over_log, position_budget, uncertainty_map

ROOT = Path(__file__).resolve().parents[2]
PUBLISHED = str(ROOT / "data" / "micromachines2019" / "table2_budget.toml")
SETTINGS = "[zeroing]\naveraged = 100\nx_nm = 20\n[reading]\nadc_step_nm = 50\n"

SAID = Settings(zero_averaged=100, zero_pose_std={"x_m": 20e-9}, adc_step=50e-9)
"""The same."""


@pytest.fixture
def here(stage: Path, monkeypatch: pytest.MonkeyPatch) -> Fit:
    monkeypatch.chdir(stage)
    Path("settings.toml").write_text(SETTINGS)
    return load_fit("calib.json")


@pytest.fixture
def ran(run):
    """Return what runs the command and returns the text that it prints."""

    def ran(*words: str) -> str:
        code, out, err = run("budget", *words)
        assert code == 0, err
        return out

    return ran


# -- a budget file ---------------------------------------------------------------------------------------


def test_the_published_budget(ran):
    said = ran(PUBLISHED)
    assert "U = 500.9 nm (k = 2)" in said
    assert "u = 250.5 nm" in said
    made = json.loads(ran(PUBLISHED, "--json"))["budget"]
    assert made["expanded_uncertainty"] == pytest.approx(500.9e-9, abs=0.05e-9)
    assert made["unit"] == "m"
    page = (ROOT / "docs" / "budget.md").read_text(encoding="utf-8")
    for line in said.splitlines():
        assert line in page.splitlines()


def test_monte_carlo_says_that_the_published_interval_is_wide(ran):
    """Two thirds of the variance is one rectangle, which has no tails."""
    said = ran(PUBLISHED, "--monte-carlo", "100000")
    assert "not confirmed" in said
    made = json.loads(ran(PUBLISHED, "--monte-carlo", "100000", "--json"))["monte_carlo"]
    assert made["trials"] == 100_000
    assert made["verdict"] == "not confirmed"


# -- a calibration ---------------------------------------------------------------------------------------


def test_a_position(ran, here):
    said = ran("calib.json", "--at", "x_um=100", "--at", "z_m=2e-4")
    first = said.splitlines()[0]
    assert first.startswith("U (k = 2) of the position at x 100 um, Z 200 um: x 3.356 um, y ")
    assert first.endswith("; fit covariance: likelihood.")
    assert "from 1 reading" in said


NOISE = {"hall_m": 7e-8, "hall_a_m": 5e-8}


@pytest.mark.parametrize(
    ("words", "at", "settings", "noise"),
    [
        (("--at", "x_um=100", "--at", "z_m=2e-4"), {"x_m": 1e-4, "z_m": 2e-4}, Settings(), {}),
        (("--settings", "settings.toml"), {}, SAID, {}),
        (("--noise", "hall_m=7e-8", "--noise", "hall_a_um=0.05"), {}, Settings(), NOISE),
    ],
    ids=["place", "settings", "noise"],
)
def test_options_are_those_of_the_function(ran, here, words, at, settings, noise):
    made = json.loads(ran("calib.json", *words, "--json"))
    columns = (*here.model.channels, *here.model.state, *here.model.references)
    known = here.changed(noise=Noise.given(noise, columns).merged(here.noise))
    for column, budget in position_budget(known, at, settings).items():
        assert made["budgets"][column]["expanded_uncertainty"] == pytest.approx(budget.expanded, rel=1e-9)
        assert made["at"][column] == pytest.approx(at.get(column, 0.0))
    assert made["map"] is made["recorded"] is made["monte_carlo"] is None
    assert made["notes"] == [] or not settings.adc_step


def test_a_place_leaves_out_nothing_but_zeros():
    """A height is small beside the travel of a mover, and no less a part of the place."""
    assert position_words({"x_m": 0.03, "y_m": 0.0, "z_m": 2e-4, "angle_rad": 0.1}) == (
        "x 30 mm, Z 200 um, angle 5.73 deg"
    )


def test_a_log_gives_rms_and_worst(ran, here):
    words = ["calib.json", "log.csv", "--settings", "settings.toml", "--noise", "hall_m=5e-7"]
    said = ran(*words, "--at", "z_um=900")
    assert "note: z_m of the budget is outside the recorded workspace" in said
    assert "recorded workspace" in said
    made = json.loads(ran(*words, "--json"))
    expected = over_log(here, with_noise(record(seed=1)), SAID)
    for column in here.model.pose:
        assert made["recorded"]["rms"][column] == pytest.approx(expected.rms[column], rel=1e-6)
        spot = made["recorded"]["worst"][column]
        budget = position_budget(here, spot["at"], SAID)[column]
        assert spot["expanded_uncertainty"] == pytest.approx(budget.expanded, rel=1e-6)


def test_a_log_at_one_height_has_a_map_of_one_height(ran, here, tmp_path):
    lines = Path("log.csv").read_text().splitlines()
    k = lines[0].split(",").index("z_m")
    rows = [
        ",".join([*row[:k], "0.0001", *row[k + 1 :]]) for row in (text.split(",") for text in lines[1:200])
    ]
    (tmp_path / "level.csv").write_text("\n".join([lines[0], *rows]) + "\n")
    made = json.loads(ran("calib.json", str(tmp_path / "level.csv"), "--range", "x_um=0:9", "--json"))
    assert made["map"]["axes"]["z_m"] == [1e-4]
    assert np.shape(made["map"]["expanded_uncertainty"]["x_m"]) == (41, 41, 1)


def test_a_map_without_a_log(ran, here):
    ranges = ["--range", "x_um=-100:100", "--range", "y_um=-50:50", "--range", "z_um=0:200"]
    said = ran("calib.json", *ranges)
    assert "U (k = 2), map" in said
    made = json.loads(ran("calib.json", *ranges, "--json"))["map"]
    axes = {"x_m": (-1e-4, 1e-4), "y_m": (-5e-5, 5e-5), "z_m": (0.0, 2e-4)}
    assert made["expanded_uncertainty"]["y_m"][0][0][0] == pytest.approx(
        uncertainty_map(here, axes).expanded[1, 0, 0, 0], rel=1e-9
    )


def test_a_log_that_leaves_parameters_open_exits_with_3(run, here, tmp_path):
    raw = json.loads(Path("calib.json").read_text())
    raw["undetermined_by_log"] = ["a_A"]
    (tmp_path / "open.json").write_text(json.dumps(raw))
    code, out, _ = run("budget", tmp_path / "open.json")
    assert code == 3
    assert "does not determine a_A" in out


# -- pictures --------------------------------------------------------------------------------------------


def test_bars_are_the_shares(here):
    budgets = position_budget(here, {"x_m": 1e-4, "z_m": 2e-4}, Settings(adc_step=1e-7, zero_averaged=9))
    figure = draw(budget_bars(budgets))
    assert len(figure.axes) == 3
    for ax, budget in zip(figure.axes, budgets.values(), strict=True):
        ends = [path.get_extents() for bars in ax.collections for path in bars.get_paths()]
        widths = {round((end.y0 + end.y1) / 2): end.x1 - end.x0 for end in ends}
        assert sum(widths.values()) == pytest.approx(100.0)
        labels = [t.get_text() for t in figure.axes[0].get_yticklabels()]
        assert widths[labels.index("hall_a noise")] == pytest.approx(
            100 * {s.name: v for s, v in budget.ranked()}["hall_a noise"]
        )


def test_the_map_shows_its_values_and_says_units(here):
    grid = uncertainty_map(here, {"x_m": (-1e-4, 1e-4), "y_m": (-2e-4, 2e-4), "z_m": [-1e-4, 1e-4]})
    figure = draw(uncertainty_picture(grid))
    maps = [ax for ax in figure.axes if ax.get_xlim() == pytest.approx((-100.0, 100.0))]
    assert len(maps) == 3 * 5
    (low, *_, high), full = figure.axes[5].get_ylim(), maps[0].collections[0].get_facecolor()[:, 3]
    centres = np.array([cell.vertices[:4].mean(axis=0) for cell in maps[0].collections[0].get_paths()])
    full = full[np.lexsort(centres.round(6).T)].reshape(41, 41)
    drawn = low + (high - low) * (full - PALEST) / (1 - PALEST)
    assert drawn == pytest.approx(1e6 * grid.expanded[0, :, :, 0].T)
    assert maps[0].get_title("left") == "Z = \N{MINUS SIGN}100 µm"
    labels = {ax.get_ylabel() for ax in figure.axes}
    assert {"U x [µm]", "U y [µm]", "U Rz [µrad]", "y [µm]"} <= labels


def test_a_map_over_one_axis_is_a_line(here):
    grid = uncertainty_map(here, {"x_m": [-1e-4, 1e-4]})
    figure = draw(uncertainty_picture(grid))
    assert [ax.get_ylabel() for ax in figure.axes] == ["U x [µm]", "U y [µm]", "U Rz [µrad]"]
    (line,) = figure.axes[0].lines
    assert line.get_ydata() == pytest.approx(1e6 * grid.expanded[0])


# -- a curve ---------------------------------------------------------------------------------------------


def test_a_budget_file_takes_a_curve(ran, here):
    said = ran(PUBLISHED, "--curve", "curve.json")
    assert "adds at most 2 %" in said
    assert "instead of 500.9 nm" in said
    record = json.loads(ran(PUBLISHED, "--curve", "curve.json", "--json"))
    assert record["curve"]["expanded_without_curve_m"] == pytest.approx(500.94e-9, abs=5e-12)
    assert ran(PUBLISHED, "--curve", "curve.json", "--monte-carlo", "20000", "--seed", "1").count("curve") > 1


def test_a_calibration_takes_a_curve(ran, here):
    words = ("calib.json", "--at", "x_um=100", "--json")
    alone, joined = (json.loads(ran(*words, *more))["budgets"] for more in ((), ("--curve", "curve.json")))
    error = json.loads(Path("curve.json").read_text())["max_error_m"]
    for c in ("x_m", "y_m"):
        square = joined[c]["standard_uncertainty"] ** 2 - alone[c]["standard_uncertainty"] ** 2
        assert square == pytest.approx(error**2, rel=1e-6)
    assert joined["rz_rad"] == alone["rz_rad"]
