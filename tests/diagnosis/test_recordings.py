"""Recordings that are proposed: how long they are, how fast, and how warm."""

from dataclasses import replace

import numpy as np
import pytest

from hallsym.diagnosis.recordings import Range, recordings

SHAFT = Range(
    pose=("angle_rad",),
    vertical=(),
    amplitude={"angle_rad": 50.0},
    centre={"angle_rad": 0.0},
    frequency_hz=1.0,
    step_s=1e-3,
    start_s=0.0,
    end_s=10.0,
    temperature=25.0,
    speed=40.0,
    turn=2 * np.pi,
)
MOVER = replace(
    SHAFT,
    pose=("x_m", "y_m"),
    vertical=("z_m",),
    amplitude={"x_m": 3e-4, "y_m": 5e-4, "z_m": 1e-4},
    centre={"x_m": 0.0, "y_m": 1.0, "z_m": 2e-4},
    turn=0.0,
)


@pytest.mark.parametrize("machine", [SHAFT, MOVER], ids=["shaft", "mover"])
@pytest.mark.parametrize(("end_s", "seconds"), [(10.0, 2.0), (0.5, 0.5)])
def test_a_run_has_2000_samples_where_the_log_is_no_shorter(machine: Range, end_s, seconds) -> None:
    asked = recordings(replace(machine, end_s=end_s))
    assert {r.run.duration_s for r in asked} == {seconds}
    assert all(r.text.endswith(f"({seconds:g} s)") for r in asked)


@pytest.mark.parametrize("machine", [SHAFT, MOVER], ids=["shaft", "mover"])
def test_a_logged_temperature_is_cycled_by_five_kelvin_over_the_plainest_motion(machine: Range) -> None:
    plain, *_, cycle = recordings(machine)
    t = np.linspace(0.0, 2.0, 401)
    assert cycle.temperature is not None
    assert cycle.temperature(t).min() == pytest.approx(20.0)
    assert cycle.temperature(t).max() == pytest.approx(30.0)
    for c in machine.pose:
        assert cycle.run.position(c, t) == pytest.approx(plain.run.position(c, t))
    assert all(r.temperature is None for r in recordings(replace(machine, temperature=None)))


def test_a_fast_motion_keeps_twelve_samples_a_period() -> None:
    fast = replace(MOVER, frequency_hz=1e3)
    said = [r.text for r in recordings(fast) if "together at" in r.text and r.temperature is None]
    assert said == ["x and y together at 83 Hz (2 s)"]
