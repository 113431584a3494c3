"""Pictures of a plan: what is drawn is what was planned, recorded and compared."""

from dataclasses import replace

import numpy as np
import pytest
from twins import SIGMAS, TRUTH, with_noise

from hallsym.experiment import Ranges, paper_ranges, plan
from hallsym.families import build
from hallsym.report.drawing import draw
from hallsym.report.results.plan import coverage
from hallsym.simulation import paper_campaign, simulate

MODEL, TABLE6 = build("stage31"), paper_campaign(0.02)


@pytest.fixture(scope="module")
def planned():
    ranges = replace(paper_ranges(), step_s=0.02, levels=2, noise=SIGMAS)
    return plan(ranges, MODEL, TRUTH, runs=10)


def words(figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def places(ax) -> list[set[tuple[int, int]]]:
    """Settings of each campaign, in the units of the axes."""
    found: dict[str, set[tuple[int, int]]] = {}
    for line in (line for line in ax.lines if line.get_marker() == "o"):
        where = ((round(float(x)), round(float(y))) for x, y in zip(*line.get_data(), strict=True))
        found.setdefault(line.get_label(), set()).update(where)
    return [*found.values()]


def test_coverage_shows_settings_and_motion_of_both(planned):
    figure = draw(coverage(planned, with_noise(simulate(MODEL, TRUTH, TABLE6, seed=0))))
    assert words(figure) == ["planned, 10 runs", "recorded, 57 runs"]
    z_rx, x_y = figure.axes[0], figure.axes[3]
    assert (z_rx.get_xlabel(), z_rx.get_ylabel()) == ("Z [µm]", "Rx [µrad]")
    after, before = places(z_rx)
    heights, tilts = (0, 50, -50, 150, -150, 250, -250), (100, -100, 250, -250, 500, -500)
    assert before == {(z, 0) for z in heights} | {(0, rx) for rx in tilts}
    assert after == {(z, rx) for z in (-250, 250) for rx in (-500, 500)}
    for marker in ("None", "o"):
        drawn = np.hstack([line.get_data() for line in x_y.lines if line.get_marker() == marker])
        assert np.allclose(np.abs(drawn).max(axis=1), (300, 500), rtol=1e-2)


def test_the_path_of_a_single_coordinate_is_drawn_over_the_run():
    ranges = Ranges({"angle_rad": (-3.0, 3.0)}, (1.0, 2.0), 1.0, runs=2)
    noise = {"v_sin_v": 3e-4, "v_cos_v": 3e-4, "angle_ref_rad": 2e-5}
    (ax,) = draw(coverage(plan(ranges, "rotary", noise=noise))).axes
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("part of the run [%]", "angle [deg]")
    part, angle = ax.lines[0].get_data()
    assert (part[0], part[-1]) == (0.0, 100.0)
    assert np.abs(angle).max() == pytest.approx(np.degrees(3.0), rel=1e-2)
