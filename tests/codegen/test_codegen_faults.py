"""C that notices a reading that is dead, stuck, at its rail, drifts or jumps.

Independent facts: the field's own equation at known poses, and noise that is drawn here; the compiled C runs
over batches. Whatever a fault is, a pose without a bit is within the stated error, and so is one without its
suspect.
"""

from functools import cache
from math import pi

import boards
import numpy as np
import pytest
from calibrations import fit_of, made
from firmware import Library, need, written
from scipy.stats import norm
from waves import LENGTH

import hallsym
from hallsym.codegen import residual
from hallsym.codegen.box import box_of
from hallsym.codegen.decoupler import ROOT
from hallsym.codegen.lowering import lower
from hallsym.estimation.goodness_of_fit import GoodnessOfFit
from hallsym.log import Noise, Sigma

SIGMA = 1e-4
KINDS = ("dead", "stuck", "rail", "drift", "jump", "not a number")
FALSE = 1_000_000
"""Samples of a sound machine, none of which may raise a bit: 1 is expected at the stated rate, at most."""


CASES = (
    "five Halls", "five probes", "nine sums", "five sums", "three sums", "12 sums", "tilted 24 sums",
    "four probes", "ellipse volts",
)  # fmt: skip
SLOW = [c for c in CASES if c not in ("nine sums", "four probes", "ellipse volts")]
ALLOWED = norm.isf(residual.FALSE_ALARMS / 2)
"""Standard deviations of a residual that one sample of a million exceeds."""
ONE_LEFT = ("four probes", "ellipse volts")
"""Cases with one reading more than unknowns: a dead one often reads what it should, of four probes within
16 to 30 um in 4 % of 600 um of travel."""
INTEGERS = (*ONE_LEFT, "five Halls", "five probes")
TRIED = [
    *(pytest.param(c, "float", marks=pytest.mark.slow if c in SLOW else ()) for c in CASES),
    *((c, "q31") for c in INTEGERS),
]


class Batch(Library):
    """Generated code compiled for this machine, on readings in SI."""

    def __init__(self, code, folder):
        need("gcc")
        super().__init__(written(code, folder), code)
        self.code = code

    def numbers(self, readings):
        """Readings (n, s) [SI] in the numbers of the arithmetic."""
        if self.code.backend.type == "float":
            return readings.astype(np.float32)
        with np.errstate(all="ignore"):
            whole = np.nan_to_num(np.round(readings / [[port.scale] for port in self.code.backend.inputs]))
        return np.clip(whole, -(2**31) + 1, 2**31 - 1).astype(np.int64)

    def __call__(self, readings):
        """Pose (n_pose, s) [SI], status (s,) and suspects (s,)."""
        pose, status, suspects = self.steps(self.numbers(readings))
        return pose * np.array([[port.scale] for port in self.code.backend.outputs]), status, suspects


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    @cache
    def of(case, arithmetic="float"):
        return Batch(made(case, arithmetic=arithmetic), tmp_path_factory.mktemp("faults") / "fw")

    return of


def noise_of(case, shape, rng):
    sigmas = [fit_of(case).noise.sigmas[c].value for c in fit_of(case).model.channels]
    more = np.zeros((shape[0] - len(sigmas), shape[1]))  # a state that is measured has none here
    return np.vstack([np.array(sigmas)[:, None] * rng.standard_normal((len(sigmas), shape[1])), more])


def faulty(kind, clean, noisy, which, d, sigma, rng):
    """Readings (n, s) with one faulty in each sample."""
    at, out = np.arange(clean.shape[1]), noisy.copy()
    ends = np.array([max(map(abs, d.ends(c))) for c in d.model.channels])[which]
    sign = rng.choice([-1.0, 1.0], len(at))
    out[which, at] = {
        "dead": 0.0 * ends,
        "stuck": clean[which, rng.permutation(len(at))],
        "rail": 1.3 * ends * sign,
        "drift": noisy[which, at] + sign * sigma[which] * 10 ** rng.uniform(0, 3, len(at)),
        "jump": noisy[which, at] + sign * ends * rng.uniform(0.3, 1.0, len(at)),
        "not a number": np.full(len(at), np.nan),
    }[kind]
    return out


def bounds_of(code):
    """Largest error of a pose without a bit, and without its suspect, by coordinate."""
    own = np.array([code.backend.error_bound[c] for c in code.decoupler.pose])
    found = code.decoupler.redundancy
    return [own + [some.get(c, 0.0) for c in code.decoupler.pose] for some in (found.unseen, found.without)]


@pytest.mark.parametrize(("case", "arithmetic"), TRIED)
def test_a_fault_raises_a_bit_or_leaves_the_stated_error(case, arithmetic, batch):
    """Two samples with the same fault at other poses; two voltages also agree at the mirrored angle."""
    step, rng = batch(case, arithmetic), np.random.default_rng(2024)
    count = 20_000 if len(step.code.decoupler.pose) < 6 else 4000
    d = step.code.decoupler
    clean = d.drawn(rng, 2 * count)
    truth, (unseen, without) = d.exact(clean), bounds_of(step.code)
    sigma = np.array([fit_of(case).noise.sigmas[c].value for c in d.model.channels])
    root = np.array([a.values for a in d.arrays if a.name == ROOT]).ravel()
    known = [k for w, r in zip(d.watched, root, strict=False) if r > 0 for k in w.readings]
    isolable = np.isin(np.arange(len(sigma)), known)
    for kind in KINDS:
        which = np.tile(rng.integers(0, len(sigma), count), 2)
        noisy = clean + noise_of(case, clean.shape, rng)
        pose, status, suspects = step(faulty(kind, clean, noisy, which, d, sigma, rng))
        off, silent = np.abs(d.difference(pose, truth)), status == 0
        far = (silent & (off > unseen[:, None]).any(axis=0)).reshape(2, -1)
        both = silent.reshape(2, -1).all(axis=0)
        assert (both & far.any(axis=0)).mean() <= 0.001, kind
        assert far.mean() <= 0.005 * (case == "ellipse volts"), kind
        degraded = status & d.degraded_bit > 0 if d.mends else np.zeros(len(status), bool)
        assert (off[:, degraded] <= without[:, None]).all(), kind
        if kind != "drift":
            assert both.mean() <= (0.005 if case in ONE_LEFT else 0.001), (kind, both.mean())
        if d.mends and kind in ("dead", "rail", "jump", "not a number"):
            assert degraded[isolable[which]].mean() > 0.98
            assert (suspects == which + 1)[degraded].mean() > (0.999 if case == "five probes" else 0.9999)


@pytest.mark.parametrize("case", ONE_LEFT)
def test_no_test_of_so_few_false_alarms_would_see_more(case):
    """A dead reading over samples at poses drawn anew. What the best test of the fault itself, known at each
    pose, leaves silent of two samples is more than .1 %; within those that the header states it is less.
    """
    rng, count = np.random.default_rng(31), 40_000
    d, backend = made(case).decoupler, made(case).backend
    stated = residual._Judgement(d, np.array([fit_of(case).noise.sigmas[c].value for c in d.model.channels]))
    sigma, which = stated.sigma, rng.integers(0, stated.n, count)

    def left(readings):
        return backend.run(backend.hold(readings.astype(np.float32))[0]).left[0].astype(float)

    silent, moved = [], []
    for _ in range(stated.samples):
        clean = d.drawn(rng, count)[:, rng.permutation(count)]
        dead = faulty("dead", clean, clean, which, d, sigma, rng)
        own = (left(clean + noise_of(case, clean.shape, rng)) - left(clean)).std()
        moved.append(left(dead) / own)
        _, status = backend.step((dead + noise_of(case, clean.shape, rng)).astype(np.float32))
        silent.append(status == 0)
    one = (norm.cdf(ALLOWED - moved[0]) - norm.cdf(-ALLOWED - moved[0])).mean()
    best = norm.cdf(norm.isf(residual.FALSE_ALARMS) - np.hypot(*moved[:2])).mean()
    assert 0.03 < silent[0].mean() < one + 4 * np.sqrt(one / count)
    assert 0.001 < best < np.mean(silent[0] & silent[1]) < 1.8 * best
    assert np.all(silent, axis=0).mean() < 1 - residual.SURE
    assert stated.samples == 3


@pytest.mark.parametrize(("case", "arithmetic"), TRIED)
def test_a_sound_machine_raises_no_bit(case, arithmetic, batch):
    step, rng = batch(case, arithmetic), np.random.default_rng(77)
    d, flagged = step.code.decoupler, 0
    clean = d.drawn(rng, 20_000)
    for _ in range(FALSE // 20_000 if case == "nine sums" else 5):
        _, status, _ = step(clean + noise_of(case, clean.shape, rng))
        flagged += int((status & (d.fault_bit | (d.degraded_bit if d.mends else 0)) != 0).sum())
    assert flagged <= 3


def test_the_limit_is_no_larger_than_it_must_be():
    """At noise five times the stated one the bit is set often: the limit comes from the noise."""
    code = made("nine sums")
    d, rng = code.decoupler, np.random.default_rng(5)
    clean = d.drawn(rng, 5000)
    _, status = code.backend.step((clean + 5 * SIGMA * rng.standard_normal(clean.shape)).astype(np.float32))
    assert (status != 0).mean() > 0.5


@pytest.mark.parametrize(
    ("case", "arithmetic"),
    [
        ("nine sums", "float"),
        ("12 sums", "float"),
        ("five Halls", "q31"),
        ("five probes", "q31"),
    ],
)
def test_the_compiled_c_names_the_suspects_that_python_does(case, arithmetic, batch):
    step, rng = batch(case, arithmetic), np.random.default_rng(9)
    backend, d = step.code.backend, step.code.decoupler
    readings, most = d.drawn(rng, 2000), max(d.ends(d.model.channels[0]))
    which = rng.integers(0, len(d.model.channels), 2000)
    readings[which, np.arange(2000)] = rng.uniform(-2 * most, 2 * most, 2000)
    given = backend.sample(np.arange(4000))  # any bits
    given[:, ::2] = step.numbers(readings)
    pose, status, suspects = step.steps(given)
    wanted = backend.whole_step(given)
    assert (pose.astype(wanted[0].dtype) == wanted[0]).all()
    assert (status == wanted[1]).all()
    assert (suspects == wanted[2]).all()
    assert 0.2 < (status & d.degraded_bit != 0).mean() < 0.6


@pytest.mark.slow
def test_an_array_that_reads_another_place_contradicts_the_others():
    """All its sums agree with one another; noise and tilt clamp the turn of two phasors at the least."""
    fit = boards.planar(**{**boards.LEVEL, "tilt": 0.001})
    noise = Noise({c: Sigma(3e-4, "given") for c in fit.model.channels})
    code, rng = hallsym.generate(fit.changed(noise=noise), accuracy=5e-6), np.random.default_rng(12)
    d = code.decoupler
    readings, other = d.drawn(rng, 5000), d.drawn(rng, 5000)
    pose, there = d.exact(readings), d.exact(other)
    y1 = [k for k, c in enumerate(d.model.channels) if c.startswith("y1")]
    readings[y1] = other[y1]
    far = np.abs(d.difference(pose, there)[1]) > 1e-3
    _, status, _ = code.backend.whole_step(readings.astype(np.float32))
    assert (status[far] != 0).all()


def test_two_faults_are_a_fault_without_a_pose(batch):
    step, rng = batch("nine sums"), np.random.default_rng(8)
    d = step.code.decoupler
    clean = d.drawn(rng, 5000)
    both = clean + noise_of("nine sums", clean.shape, rng)
    both[2], both[6] = 0.0, 0.0
    pose, status, _ = step(both)
    off = np.abs(d.difference(pose, d.exact(clean)))
    degraded, (_, without) = status & d.degraded_bit != 0, bounds_of(step.code)
    assert (status != 0).mean() > 0.999
    assert (off[:, degraded] <= without[:, None]).all()  # one of the two happens to read what it should
    assert degraded.mean() < 0.02


def test_the_mended_pose_does_not_depend_on_what_the_suspect_reads(batch):
    step, rng = batch("nine sums"), np.random.default_rng(4)
    d = step.code.decoupler
    clean = d.drawn(rng, 500)
    poses = []
    for value in (0.9, -1.2, np.inf):
        given = clean.copy()
        given[3] = value
        pose, status, suspects = step(given)
        usable = status & d.degraded_bit != 0
        poses.append(np.where(usable & (suspects == 4), pose, np.nan))
    same = np.isfinite(poses).all(axis=(0, 1))
    assert same.mean() > 0.95
    assert (poses[0][:, same] == poses[1][:, same]).all()
    assert (poses[0][:, same] == poses[2][:, same]).all()


def test_a_reading_that_nothing_checks_is_said(batch):
    three = made("stage31")
    assert "nothing is left over" in " ".join(three.decoupler.of_faults)
    assert "nothing is left over" in " ".join(three.files["decoupler.h"].split(" * "))
    alike = boards.planar(**boards.LEVEL, without="Y2")
    assert "x1_0_v, x1_1_v, x1_2_v; x2_0_v" in " ".join(hallsym.generate(alike).decoupler.of_faults)
    four = " ".join(made("four probes").decoupler.of_faults)
    assert "hall_a_m, hall_b_m, hall_c_m, hall_d_m" in four
    assert "suspect" not in made("four probes").files["decoupler.h"]


def test_noise_that_the_fit_leaves_widens_the_limit():
    fit = fit_of("five sums")
    left = dict.fromkeys(fit.model.channels, 3.0)
    worse = fit.changed(goodness=GoodnessOfFit(3.0, 9.0, 1e4, {}, left, 1, "col_0_v", 3.0, 2.9))

    def least(some):
        return -next(e.value for e in lower(some, box_of(some)).table if e.name == residual.LEAST)

    plain = fit.changed(goodness=None)
    assert 4 < least(worse) / least(plain) < 9.1


def test_a_stated_number_is_one_of_the_arithmetic():
    """Nine equal sums, one fault: what is left of it is 7/9 of its square, and the wave moves by 2/9 of
    it."""
    d = made("nine sums").decoupler
    judge = residual._Judgement(d, np.full(9, SIGMA))
    assert judge.freedom == 7
    assert judge.seen / SIGMA**2 == pytest.approx(np.full_like(judge.seen, 7 / 9), rel=0.1)
    weakest = 4 * 0.8875 * np.exp(-2 * pi * 0.01 / LENGTH)
    moved = np.abs(judge.slopes[0]).max() / SIGMA
    assert moved == pytest.approx(2 / 9 * LENGTH / (2 * pi) / weakest, rel=0.1)
