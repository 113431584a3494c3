"""Campaigns: what signals do over time, the article's 57 runs, and what a campaign file may say."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.errors import InputError
from hallsym.simulation import (
    Campaign,
    Run,
    multi_sine,
    paper_campaign,
    read_campaign,
    sine,
    steps,
    triangle,
    write_campaign,
)

amplitudes = st.floats(1e-6, 1e-3)
frequencies = st.floats(0.1, 50.0)
EPS = float(np.finfo(float).eps)
AXES = ("x_m", "y_m", "rz_rad", "z_m", "rx_rad", "ry_rad")


# -- signals ---------------------------------------------------------------------------------------------


@settings(max_examples=25)
@given(amplitudes, frequencies, st.integers(1, 20))
@pytest.mark.parametrize("make", [sine, triangle])
def test_sine_and_triangle_start_at_zero_rise_reach_the_amplitude_and_repeat(make, amplitude, f, n):
    signal = make(amplitude, f)
    assert abs(signal(np.zeros(1))[0]) <= 4 * EPS * amplitude
    quarter = np.array([1, 2, 3, 4]) / (4 * f)
    assert np.allclose(
        signal(quarter), amplitude * np.array([1, 0, -1, 0]), rtol=0, atol=64 * EPS * amplitude
    )
    t = np.linspace(0, 1 / f, 101)
    assert signal(t[:2])[1] > 0
    assert np.abs(signal(t)).max() <= amplitude * (1 + 4 * EPS)
    # a phase of 2 pi f t is rounded to EPS of itself: n periods later, n times that
    assert np.allclose(signal(t + n / f), signal(t), rtol=0, atol=64 * (n + 1) * EPS * amplitude)


@settings(max_examples=25)
@given(amplitudes, st.lists(st.integers(1, 40), min_size=1, max_size=12, unique=True))
def test_multi_sine_starts_at_zero_stays_below_its_amplitude_and_holds_its_frequencies(amplitude, whole):
    signal = multi_sine(amplitude, [float(f) for f in whole])
    t = np.arange(512) / 512
    x = signal(t)
    assert abs(x[0]) <= 64 * EPS * amplitude
    assert np.abs(x).max() <= amplitude * (1 + 64 * EPS)
    lines = np.abs(np.fft.rfft(x))[1:] / 256
    expected = np.isin(np.arange(1, 257), whole) * amplitude / (2 * len(whole))
    assert np.allclose(lines, expected, rtol=0, atol=1e-12 * amplitude)


def test_steps_hold_each_level_and_begin_again():
    t = np.arange(70) * 0.01
    expected = np.repeat([0.0, 1e-3, -2e-3, 0.0, 1e-3, -2e-3, 0.0], 10)
    assert np.array_equal(steps([0.0, 1e-3, -2e-3], 0.1)(t), expected)


def test_steps_change_on_the_tick_whatever_its_rounding():
    """0.1 s is 100 ticks of 1 ms, even where k * 0.001 rounds to just below."""
    t = np.arange(10_000) * 0.001
    expected = (np.arange(10_000) // 100) % 2
    assert np.array_equal(steps([0.0, 1.0], 0.1)(t), expected)


# -- the article's campaign ------------------------------------------------------------------------------


def test_the_articles_campaign_has_57_runs_in_the_order_of_table_a1():
    campaign = paper_campaign()
    assert len(campaign.runs) == 57
    assert campaign.rows == 57 * 500
    order = [(run.setting["z_m"], run.setting["rx_rad"], run.setting["ry_rad"]) for run in campaign.runs[::3]]
    z = [0, -250, 250, -150, 150, -50, 50]
    tilt = [-500, 500, -250, 250, -100, 100]
    expected = [(v, 0, 0) for v in z] + [(0, v, 0) for v in tilt] + [(0, 0, v) for v in tilt]
    assert np.allclose(order, np.array(expected) * 1e-6, rtol=1e-12)


def test_each_run_of_the_article_moves_one_axis_by_its_amplitude_about_its_setting():
    t = np.arange(500) * 2e-3
    for k, run in enumerate(paper_campaign().runs):
        moving, amplitude = [("y_m", 500e-6), ("x_m", 300e-6), ("rz_rad", 300e-6)][k % 3]
        assert set(run.motion) == {moving}
        assert np.allclose(run.position(moving, t), amplitude * np.sin(2 * np.pi * t), rtol=0, atol=1e-15)
        for axis in ("x_m", "y_m", "rz_rad", "z_m", "rx_rad", "ry_rad"):
            if axis != moving:
                assert np.all(run.position(axis, t) == run.setting.get(axis, 0.0))


def test_the_articles_deviations_belong_to_their_runs():
    """Rows of Table A1 typed from the article: (1, y), (3, rz), (2, y), (7, x)."""
    runs = paper_campaign().runs
    for k, micrometres in {
        0: (0.87, 0.52, 0.26),
        5: (1.05, 0.58, 0.86),
        6: (-0.93, 1.60, 1.92),
        16: (1.97, 1.23, -0.09),
    }.items():
        assert np.allclose(runs[k].offsets, np.array(micrometres) * 1e-6, rtol=1e-12)


# -- campaign files --------------------------------------------------------------------------------------

GOOD = """
step_s = 1e-3
zero_spread_m = 2e-6
[noise]
hall_m = 5e-7
[[setting]]
z_m = 1e-4
[[setting]]
rx_rad = -2e-4
[[trajectory]]
duration_s = 0.5
x_m = { kind = "sine", amplitude = 3e-4, frequency_hz = 2.0 }
z_m = { kind = "steps", levels = [0.0, 5e-5], dwell_s = 0.1 }
[[trajectory]]
duration_s = 0.25
x_m = { kind = "triangle", amplitude = 1e-3, frequency_hz = 8 }
y_m = { kind = "triangle", amplitude = 5e-4, frequency_hz = 4 }
"""


@pytest.fixture
def written(tmp_path):
    def write(text: str):
        path = tmp_path / "c.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


def test_a_campaign_file_runs_every_trajectory_at_every_setting(written):
    campaign = read_campaign(written(GOOD))
    assert (campaign.step_s, campaign.zero_spread_m, campaign.noise) == (1e-3, 2e-6, {"hall_m": 5e-7})
    assert [campaign.samples(run) for run in campaign.runs] == [500, 250, 500, 250]
    assert [dict(run.setting) for run in campaign.runs] == [{"z_m": 1e-4}] * 2 + [{"rx_rad": -2e-4}] * 2
    t = np.array([0.0, 0.125, 0.15])
    assert np.allclose(campaign.runs[0].position("x_m", t), [0, 3e-4, 3e-4 * np.sin(0.6 * np.pi)], atol=1e-18)
    assert np.allclose(campaign.runs[0].position("z_m", t), [1e-4, 1.5e-4, 1.5e-4], rtol=1e-15)
    raster = campaign.runs[1]
    assert raster.position("x_m", np.array([1 / 32]))[0] == pytest.approx(1e-3, rel=1e-12)
    assert raster.position("y_m", np.array([1 / 16]))[0] == pytest.approx(5e-4, rel=1e-12)
    assert all(run.offsets is None for run in campaign.runs)


def test_without_settings_there_is_one_at_rest(written):
    campaign = read_campaign(
        written('[[trajectory]]\nduration_s = 1\nx_m = {kind="sine", amplitude=1e-4, frequency_hz=1}')
    )
    assert len(campaign.runs) == 1
    assert campaign.step_s == 2e-3


BAD = {
    "not TOML": ("step_s = ", "not valid TOML"),
    "no trajectory": ("step_s = 1e-3", "trajectory"),
    "unknown key": (GOOD.replace("step_s", "stepp_s", 1), "did you mean 'step_s'"),
    "unknown axis": (GOOD.replace("rx_rad", "rx_deg", 1), "rx_deg"),
    "negative step": (GOOD.replace("1e-3", "-1e-3", 1), "positive"),
    "no duration": (GOOD.replace("duration_s = 0.5", "", 1), "duration_s"),
    "unknown signal": (GOOD.replace('"sine"', '"sinus"'), "did you mean 'sine'"),
    "signal is a number": (re.sub(r"x_m = .*2.0 }", "x_m = 3", GOOD), "kind"),
    "no amplitude": (GOOD.replace("amplitude = 3e-4, ", ""), "amplitude"),
    "unknown signal key": (
        GOOD.replace("frequency_hz = 2.0", "frequency_hz = 2.0, phase_deg = 3"),
        "phase_deg",
    ),
    "zero frequency": (GOOD.replace("frequency_hz = 2.0", "frequency_hz = 0"), "frequency_hz"),
    "no levels": (GOOD.replace("[0.0, 5e-5]", "[]"), "levels"),
}

RUNS = """
[[run]]
name = "corner"
duration_s = 0.5
z_m = -2.5e-4
x_m = { kind = "sine", about = 1e-4, amplitude = 3e-4, frequency_hz = 2.0 }
[[run]]
duration_s = 0.25
zero_deviations_m = [1e-6, -2e-6, 0]
x_m = { kind = "triangle", amplitude = 1e-3, frequency_hz = 8 }
y_m = { kind = "triangle", amplitude = 5e-4, frequency_hz = 4 }
"""
BAD |= {
    "no run": ("run = []", r"\[\[run\]\]"),
    "settings without trajectory": ("[[setting]]\nz_m = 0.0\n" + RUNS, "trajectory"),
    "unknown key of a run": (RUNS.replace("z_m =", "zz_m ="), "did you mean 'z_m'"),
    "name as a number": (RUNS.replace('"corner"', "3"), "name"),
    "about in a trajectory": (GOOD.replace("amplitude = 3e-4", "about = 0.0, amplitude = 3e-4"), "about"),
}


@pytest.mark.parametrize("what", BAD)
def test_a_bad_campaign_file_is_refused_in_one_sentence(written, what):
    text, said = BAD[what]
    assert text != GOOD
    with pytest.raises(InputError, match=said) as caught:
        read_campaign(written(text))
    message = str(caught.value)
    assert message.endswith((".", "?"))


# -- single runs, and campaigns that are written ---------------------------------------------------------


def test_single_runs_hold_axes_or_move_them_about_a_place(written):
    corner, raster = read_campaign(written(RUNS)).runs
    t = np.array([0.0, 0.125])
    assert corner.name == "corner"
    assert np.allclose(corner.position("x_m", t), [1e-4, 4e-4], rtol=1e-12)
    assert np.all(corner.position("z_m", t) == -2.5e-4)
    assert corner.offsets is None
    assert raster.offsets == (1e-6, -2e-6, 0.0)
    assert raster.position("y_m", np.array([1 / 16]))[0] == pytest.approx(5e-4, rel=1e-12)


def test_single_runs_follow_the_product_of_settings_and_trajectories(written):
    both = read_campaign(written(GOOD + RUNS))
    assert [run.duration_s for run in both.runs] == [0.5, 0.25, 0.5, 0.25, 0.5, 0.25]
    assert both.runs[4].name == "corner"


def same(a: Campaign, b: Campaign) -> bool:
    """Whether two campaigns are the same to the bit: clock, noise, and every run."""
    head = (a.step_s, a.zero_spread_m, dict(a.noise or {})) == (
        b.step_s,
        b.zero_spread_m,
        dict(b.noise or {}),
    )
    return head and [_key(r) for r in a.runs] == [_key(r) for r in b.runs]


def _key(run: Run) -> tuple:
    places = {axis: float(v) for axis, v in run.setting.items()}
    return (run.name, run.duration_s, places, dict(run.motion), run.offsets)


numbers = st.floats(-1e-3, 1e-3)
signals = st.one_of(
    st.builds(sine, numbers, frequencies, numbers),
    st.builds(triangle, numbers, frequencies),
    st.builds(multi_sine, numbers, st.lists(frequencies, min_size=1, max_size=4)),
    st.builds(steps, st.lists(numbers, min_size=1, max_size=4), frequencies),
)
runs = st.builds(
    Run,
    st.floats(1e-3, 1e3),
    st.dictionaries(st.sampled_from(AXES), numbers),
    st.dictionaries(st.sampled_from(AXES), signals),
    st.none() | st.tuples(numbers, numbers, numbers),
    st.text(st.characters(exclude_categories=["Cs"]), max_size=8),
)


@settings(max_examples=30)
@given(
    st.builds(
        Campaign,
        st.floats(1e-3, 1.0),
        st.lists(runs, min_size=1, max_size=3).map(tuple),
        st.floats(0, 1e-5),
        st.dictionaries(st.sampled_from(["hall_m", "z_nm", "x ref", "ü"]), st.floats(1e-9, 1.0)),
    )
)
def test_every_campaign_survives_a_file(tmp_path_factory, campaign):
    path = tmp_path_factory.mktemp("campaign") / "c.toml"
    write_campaign(campaign, path)
    assert same(read_campaign(path), campaign)


def test_a_motion_that_is_a_plain_function_is_not_written(tmp_path):
    campaign = Campaign(1e-3, (Run(1.0, {}, {"x_m": np.sin}),))
    with pytest.raises(InputError, match="function or a curve"):
        write_campaign(campaign, tmp_path / "c.toml")
    assert not (tmp_path / "c.toml").exists()
