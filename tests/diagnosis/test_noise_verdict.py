"""Noise that is larger than stated is a verdict of its own: by how much, where, whether white; and no gap."""

from dataclasses import replace

import numpy as np
import pytest
from gap_twins import SIGMA, Inject, Motion, add, gains, machine, unlisted

from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.log import Log, Noise
from hallsym.report.views import summary

LARGER = "noise larger than stated"


def quiet(seed: int = 3, noise: str = "white", campaign: str = "multisine") -> Log:
    """A machine without a gap."""
    return machine(campaign, seed=seed, thin=6, pink=0.0, curvature=0.0, noise=noise)


def stated_as(log: Log, factor: float) -> Log:
    """The log with its noise stated as `factor` times what it is."""
    return replace(
        log, noise=Noise({c: replace(s, value=s.value * factor) for c, s in log.noise.sigmas.items()})
    )


@pytest.mark.parametrize(
    ("noise", "white"), [("white", True), pytest.param("correlated", False, marks=pytest.mark.slow)]
)
def test_noise_larger_than_stated_is_told_as_such(noise: str, white: bool) -> None:
    d = diagnose(stated_as(quiet(noise=noise), 1 / 1.4))
    assert d.verdict == LARGER
    assert d.noise is not None
    assert d.noise.interval[0] < 1.4 < d.noise.interval[1]
    assert d.noise.white is white
    assert d.noise.larger_in == ("hall_a_m", "hall_b_m", "hall_c_m")
    assert (d.effects, d.ranked, d.where, d.remaining, d.next_step) == ((), (), (), (), ())
    assert d.sentence.startswith("Noise larger than stated. The error on the holdout runs is ")
    assert "x the stated noise (95 %: " in d.sentence
    assert ("in every sensor, white" if white else "correlated in time") in d.sentence
    assert d.sentence in summary(d).replace("\n", " ")
    assert Diagnosis.from_dict(d.to_dict()).noise == d.noise


@pytest.mark.slow
def test_one_sensor_that_is_noisier_is_named() -> None:
    def loud(m: Motion, rng: np.random.Generator, out: dict) -> None:
        out["hall_b_m"] = out["hall_b_m"] + 2 * SIGMA["hall_b_m"] * rng.standard_normal(len(m.t))

    loud.late = True  # type: ignore[attr-defined]
    d = diagnose(machine("multisine", (loud,), seed=3, thin=6, pink=0.0, curvature=0.0))
    assert d.verdict == LARGER
    assert d.noise is not None
    assert d.noise.larger_in == ("hall_b_m",)
    # reading noise of 0.5 um becomes sqrt(5) times as large, beside what the reference's 0.3 um make of it
    reference = 0.3 * float(gains(np.zeros((3, 1)))[1, 0])
    expected = np.sqrt((5 * 0.5**2 + reference**2) / (0.5**2 + reference**2))
    assert d.noise.by_sensor["hall_b_m"] == pytest.approx(expected, rel=0.06)
    assert "in hall_b alone, white" in d.sentence


@pytest.mark.slow
def test_estimated_noise_is_never_larger_than_stated() -> None:
    d = diagnose(replace(quiet(noise="correlated"), noise=Noise({})))
    assert d.verdict == "no gap"
    assert d.metric.before == pytest.approx(d.metric.floor, rel=0.08)
    assert d.where == ()


def tone(hz: float) -> Inject:
    """A wave that belongs to no effect."""

    def inject(m: Motion, _: np.random.Generator) -> None:
        phase = np.array([0.0, 1.0, 2.0])[:, None]
        m.reading = m.reading + 1.2e-6 * np.sin(2 * np.pi * hz * (m.start + m.t) + phase)

    return inject


def sweep(m: Motion, _: np.random.Generator) -> None:
    """A wave that sweeps through all frequencies: no line, white on the whole, and no noise."""
    m.reading = m.reading + 1.2e-6 * np.sin(2 * np.pi * (2 + 4 * m.t) * m.t + np.array([[0.0], [1.0], [2.0]]))


@pytest.mark.slow
@pytest.mark.parametrize("inject", [tone(23.7), sweep, unlisted(np.random.default_rng(5))["wander"]])
def test_a_gap_is_not_taken_for_noise(inject: Inject) -> None:
    d = diagnose(machine("multisine", (inject,), seed=5, thin=6, pink=0.0, curvature=0.0))
    assert d.verdict == "unexplained"


@pytest.mark.slow
def test_an_effect_beside_larger_noise_is_explained() -> None:
    cubic = add(lambda m: 4e5 * m.reading**3)
    log = machine("multisine", (cubic,), seed=3, thin=6, pink=0.0, curvature=0.0)
    d = diagnose(stated_as(log, 1 / 1.4))
    assert (d.verdict, d.ranked[0]) == ("explained", "odd_nonlinearity")
    assert d.noise is not None
    assert d.noise.ratio == pytest.approx(1.4, rel=0.03)


@pytest.mark.slow
def test_a_shape_is_a_gap_below_a_noise_that_is_stated_too_large() -> None:
    gap = unlisted(np.random.default_rng(5))["bump"]
    log = machine("multisine", (gap,), seed=3, thin=6, pink=0.0, curvature=0.0)
    d = diagnose(stated_as(log, 3.0))
    assert d.metric.before < d.metric.floor
    assert d.verdict == "unexplained"
