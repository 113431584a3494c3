"""Rates over a sample of recordings with a mistake and of healthy ones, held at what is reached.

`tests/benchmarks/bench_recordings.py` runs all of them and lists each that came to no good end.
"""

from __future__ import annotations

import pytest
from recording_scores import judged, rates, same, told
from recordings import FAMILIES, Size, cases, healthy_cases, mistaken

SEED = 4
SMALL = Size(16, 100, 4e-3)
"""Enough to tell mistakes, and quick to fit."""
QUICK = tuple(family for family in FAMILIES if family != "planar")
"""A fit of the planar mover takes a second or more."""
EVERY = 23
"""One of so many cases is taken: no divisor of the number of families."""


def test_corrections_are_compared_by_what_they_do() -> None:
    r = mistaken("sign of a reading, run", "stage31", "0").recording
    assert same("scale rx_rad deg", "scale rx_rad 0.0174533", r)
    assert same("scale x_ref_m in in 3", "scale x_ref_m 0.0254 in 3", r)
    assert same("gain_step hall_a_m 1.05 in 2", "scale hall_a_m 0.952381 in 2", r)
    assert not same("scale rx_rad mrad", "scale rx_rad deg", r)
    assert not same("sign hall_a_m", "sign hall_a_m in 2", r)
    assert not same("delay hall_a_m 2", "delay hall_a_m -2", r)


@pytest.mark.slow
def test_rates_of_mistakes() -> None:
    drawn = [case for case in cases(SEED) if case[1] in QUICK][::EVERY]
    found = rates([judged(*case, SMALL) for case in drawn])
    assert found["noticed"] >= 0.9, found
    assert found["silent"] <= 0.08, found
    assert found["right"] >= 0.5, found
    assert found["wrong"] <= 0.08 * found["felt"], found


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "family", "seed"),
    [
        ("reading of 3 bits, run", "stage31", "2926.0"),  # few values in a run: not stuck
        ("reading stuck, few", "stage30", "2940.0"),  # at a rail a reading is expected beyond it
        ("blocks of readings repeated, log", "rotary", "3612.0"),  # samples of an earlier time, in each run
        ("reading stuck at its extreme, run", "stage31", "3612.0"),  # no rail: it is expected below
        ("sign of a reference, few", "chip", "2940.0"),  # a phase has no more variance than its turn
        ("another device, few", "halbach", "2940.0"),  # gains of its own, which the model has not
        ("another device, few", "stage31", "2966.0"),  # a parameter is at its bound
        ("another device, few", "stage30", "2966.0"),  # its noise is correlated, more than an estimate shows
        ("zero of a reference moved, run", "stage30", "2967.0"),  # no state is as noisy as that reference
        ("another device, few", "stage31", "2964.0"),  # a gain leaves a run at 100 times the noise
        ("reading gain +20%, tail", "stage31", "2940.0"),  # one gain of several runs, not several mistakes
        ("reading clipped in 5%, run", "stage30", "2940.0"),  # what it leaves is noise up to chance
        ("all lengths x 1000, log", "stage30", "2944.0"),  # a file in mm, readings too
        ("reading x 1000, log", "homed", "2940.0"),  # of decades that do as well the one of a unit
        ("reference x 0.001, log", "homed", "3604.0"),  # no tangent of the wrong fit knows its amplitude
        ("reading 20 samples off, log", "homed", "2951.0"),  # without what it holds one run would be odd
        ("zero of a reference moved, few", "drawn", "2940.0"),  # inches would leave no noise of a reference
        ("reference averaged over 3, log", "stage31", "2944.0"),  # ends of runs are left out as spikes
        ("all references of 5 bits, log", "halbach", "2955.0"),  # their rounding is estimated as their noise
        ("two states exchanged, log", "drawn", "2986.0"),  # gains absorb it: the axis of the tilts shows it
        ("reference x 10, run", "planar", "2997.0"),  # nearly a scale of the whole log
        ("sign of a reading, log", "planar", "5.0"),  # what leaves noise beyond numbers is tried too
    ],
)
def test_the_right_one_of_several_hypotheses_is_named(kind: str, family: str, seed: str) -> None:
    m = mistaken(kind, family, seed)
    first = next((one.correction for one in told(m.recording)[0].claims if one.correction), None)
    assert first
    assert any(same(first, right, m.recording) for right in m.right)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "family", "seed"),
    [
        ("reference in counts, log", "drawn", "2944.0"),  # a gain makes up for a factor of two
        ("reading 20 samples off, run", "chip", "2945.0"),  # late by a third of a turn, held at its beginning
        ("reference averaged over 3, log", "homed", "2994.0"),  # ends of runs are all that is off
        ("all readings x 0.001, log", "rotary", "2955.0"),  # amplitudes make up for each power of ten
        ("all readings averaged over 9, log", "halbach", "2955.0"),  # what no noise is as large as
    ],
)
def test_what_no_correction_explains_is_noticed_without_one(kind: str, family: str, seed: str) -> None:
    fit = told(mistaken(kind, family, seed).recording)[0]
    assert fit.claims or fit.goodness.sentence
    assert [one.correction for one in fit.claims] == [None] * len(fit.claims)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "family", "seed"),
    [
        ("hysteresis", "rotary", "10.0"),  # every second run goes back: play differs there too
        ("temperature drift", "stage31", "2953.0"),  # one calibration describes all runs nearly
        ("temperature drift", "drawn", "2953.0"),  # parameters of their own leave more than noise
    ],
)
def test_runs_that_effects_make_differ_are_not_of_another_device(kind: str, family: str, seed: str) -> None:
    assert judged(kind, family, seed).claims == []


@pytest.mark.slow
def test_no_claim_of_a_mistake_in_healthy_logs() -> None:
    drawn = [case for case in healthy_cases(SEED) if case[1] in QUICK][::4]
    found = rates([judged(*case) for case in drawn])
    assert found["false"] == 0, found
