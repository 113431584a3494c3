"""Position and speed at the time that a controller asks for.

Independent facts: a machine at constant speed is where it will be; steady acceleration leaves a T^2 / h
(Zarchan, Musoff); the references of the bundled campaign, which no decoder saw; random numbers leave what is
finite finite.
"""

from copy import copy
from ctypes import c_float, c_uint32
from functools import cache

import numpy as np
import pytest
from firmware import Library, calibration, need, passes, written

import hallsym
from hallsym.codegen import Observer, followed, observer_of
from hallsym.errors import InputError
from hallsym.families.recording import read_correction

PERIOD = 0.01


@cache
def observed():
    return observer_of(calibration(), hallsym.bundled_campaign())


@cache
def generated():
    return hallsym.generate(calibration(), observer=Observer(10.0, PERIOD, latency_s=0.002))


@pytest.fixture(scope="module")
def tracker(tmp_path_factory):
    need("gcc")
    return Tracker(written(generated(), tmp_path_factory.mktemp("predict") / "fw"), generated())


class Tracker(Library):
    """Three positions with their speeds, a gap and a number of samples."""

    def start(self):
        self.state = np.zeros(8, np.float32)

    def track(self, pose, dt, status=0):
        at = np.asarray(pose, np.float32)
        self.call("decoupler_track", self.table, self.state, at, c_uint32(status), c_float(dt))

    def predict(self, ahead):
        out = np.zeros(3, np.float32)
        return out, self.call("decoupler_predict", self.table, self.state, c_float(ahead), out)


def test_a_machine_at_constant_speed_is_where_it_will_be_latency_included(tracker):
    speed = np.array([2e-3, -1e-3, 5e-4])
    tracker.start()
    t = 0.0
    for k, dt in enumerate(np.tile([0.008, 0.012], 60)):  # timestamps that jitter
        t += dt if k else 0.0
        tracker.track(speed * t, dt)
    found, bits = tracker.predict(0.005)
    assert bits == 0
    assert np.abs(found - speed * (t + 0.005 + 0.002)).max() < 1e-9


def test_steady_acceleration_leaves_what_is_stated(tracker):
    a, tau = 0.002, 0.002
    tracker.start()
    for k in range(200):
        tracker.track(np.full(3, a * (k * PERIOD) ** 2 / 2), PERIOD)
    found, _ = tracker.predict(PERIOD - tau)
    left = a * (200 * PERIOD) ** 2 / 2 - found
    assert left == pytest.approx(np.full(3, a * Observer(10.0, PERIOD).lag), rel=2e-2)


def test_a_gap_and_a_start_are_told_and_an_unusable_sample_is_passed_over(tracker):
    tracker.start()
    assert tracker.predict(0.0)[1] == 1
    for k in range(100):
        tracker.track([1e-3 * k * PERIOD, 0, 0], PERIOD, status=4 if k == 90 else 0)
    assert tracker.predict(0.0)[1] == 0
    assert tracker.predict(0.0)[0][0] == pytest.approx(1e-3 * (99 * PERIOD + 0.002), abs=1e-9)
    assert [tracker.predict(v)[1] for v in (0.027, 1.0, np.nan, -1.0)] == [0, 2, 2, 2]
    tracker.track([5e-4, 0, 0], 0.5)
    found, bits = tracker.predict(0.01)
    assert (bits, found[0]) == (1, np.float32(5e-4))


OBSERVED = ("observer_position", "observer_speed", "longest_gap", "fastest_x", "fastest_y", "fastest_rz")
TIMES = (PERIOD, 0.03, 1e-6, 0.017, 10.0, np.nan, -1.0, np.inf, 1e30)


@pytest.mark.parametrize("side", [None, 0, 1])
def test_whatever_comes_the_prediction_is_finite(tracker, side):
    """With the numbers of the observer at their least and greatest values too."""
    code, rng = generated(), np.random.default_rng(3)
    table = bytes(code.backend.binary)
    for name in OBSERVED if side is not None else ():
        value = next(e.value for e in code.decoupler.entries if e.name == name)
        end = code.backend.accepted[name][side]
        table = table.replace(np.float32(value).tobytes(), np.float32(end).tobytes())
    other = copy(tracker)
    other.start()
    other.table = np.frombuffer(table, dtype=np.uint8).copy()
    for _ in range(5000):
        other.track(rng.uniform(-1e-3, 1e-3, 3), rng.choice(TIMES), status=int(rng.integers(0, 2)))
        found, _ = other.predict(rng.choice((0.0, 0.02, 10.0, np.nan, np.inf, 1e30)))
        assert np.abs(found).max() < (0.1 if side is None else np.inf)
    assert np.abs(other.state[:6]).max() < 1e6


def test_on_the_bundled_campaign_the_error_hardly_grows_with_speed():
    observer, log = observed(), hallsym.bundled_campaign()
    for one in followed(calibration(), log, observer):
        slow, fast = one.predicted[0], one.predicted[-1]
        assert fast < one.last[-1] / 4  # a fifth of a period is 10 to 25 um at the largest speed
        assert fast < 2.5 * slow
        assert slow < 1.6 * one.last[0]  # what a prediction costs at rest: more noise
        assert f"{fast:.2g} {'rad' if one.column[0] == 'r' else 'm'}" in " ".join(observer.said)
    others = [observer_of(calibration(), log, bandwidth_hz=hz) for hz in (2.0, 5.0)]
    worse = [followed(calibration(), log, other)[0].predicted[-1] for other in others]
    assert worse[0] > worse[1] > followed(calibration(), log, observer)[0].predicted[-1]


def test_a_log_is_followed_without_the_mistakes_that_the_calibration_corrects():
    log, one = hallsym.bundled_campaign(), read_correction(f"sign {calibration().model.channels[1]}")
    columns = {name: log.array(name) for name in log.columns}
    columns[one.columns[0]] = -columns[one.columns[0]]
    fit, mistaken = calibration().changed(corrections=(one,)), hallsym.Log.from_arrays(columns)
    (right, *_), (found, *_) = followed(calibration(), log, observed()), followed(fit, mistaken, observed())
    assert found.predicted == pytest.approx(right.predicted, rel=1e-6)


@pytest.mark.slow
def test_the_folder_passes_its_self_test(tmp_path):
    passes(written(hallsym.generate(calibration(), observer=observed()), tmp_path / "fw"))


@pytest.mark.parametrize(("hz", "period"), [(50.0, 0.01), (0.0, 0.01), (10.0, 0.0), (np.nan, 0.01)])
def test_a_bandwidth_that_follows_noise_is_refused(hz, period):
    with pytest.raises(InputError, match="bandwidth"):
        Observer(hz, period)
