"""Every threshold of the policy decides something: each has a test here that fails without it.

A stage is a function of records, so most tests give it small records made by hand. The others diagnose small
simulated logs twice, with the policy and with one threshold switched off.
"""

import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from gap_twins import listed
from gap_twins import machine as stage
from test_diagnosis_rotary import machine, third
from test_diagnosis_turn import LIKE_A_TABLE, table

from hallsym.diagnosis import POLICY, Diagnosis, diagnose, prepare
from hallsym.diagnosis.confusable import smaller_findings
from hallsym.diagnosis.faults import of_samples
from hallsym.diagnosis.lack_of_fit import LackOfFit, Shape
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.refit import refit, with_model
from hallsym.diagnosis.scores import Score
from hallsym.diagnosis.selection import Exact, cancels, ordered, select
from hallsym.diagnosis.setup import Floor
from hallsym.diagnosis.sign_flips import clusters, memory, stretch
from hallsym.diagnosis.spectrum import spectrum_peak
from hallsym.diagnosis.validation import decide, remains
from hallsym.families import effect_named
from hallsym.log import Log

CONFUSABLE, SELECTION = (sys.modules[f"hallsym.diagnosis.{name}"] for name in ("confusable", "selection"))
"""The modules; the package has functions of these names."""

LEVEL = 0.05
FLOOR = Floor({"x_m": 1e-6}, 1e-6)
CLEAN = LackOfFit(())


def shaped(drop: float, p: float) -> LackOfFit:
    return LackOfFit((Shape("x", drop, p),))


# -- is what is left a gap, and the verdict ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("found", "excess", "error", "gap"),
    [
        (CLEAN, 1.08, 0.0, False),  # 5 % above a floor that is known to 3 %
        (CLEAN, 1.09, 0.0, True),
        (CLEAN, 1.15, 0.01, True),
        (CLEAN, 1.15, 0.05, False),  # noise with a long memory makes as much by chance
        (shaped(0.2, 0.2), 0.5, 0.0, False),
        (shaped(0.2, 0.01), 0.5, 0.0, True),  # a shape is a gap whatever the floor is said to be
    ],
)
def test_what_is_left_is_a_gap_above_all_that_the_floor_may_be_or_with_a_shape(found, excess, error, gap):
    assert remains(found, excess * FLOOR.metric, FLOOR, LEVEL, POLICY, error) is gap
    if found is CLEAN:
        twice = replace(FLOOR, uncertain=2.0)
        assert not remains(found, excess * FLOOR.metric, twice, LEVEL, POLICY, error)
        assert remains(found, 2 * excess * FLOOR.metric, twice, LEVEL, POLICY, error) is gap


def validated(after: float, rest: LackOfFit) -> SimpleNamespace:
    """A validation that names an effect which lowers a gap of 4 um to `after`."""
    end = object()
    return SimpleNamespace(
        named=True, metric=after, before=SimpleNamespace(metric=4e-6), base=end, end=end, rest=rest,
        floor=FLOOR, error=0.0, dropped=(),
    )  # fmt: skip


def test_a_gap_is_explained_only_where_nearly_all_is_closed():
    setup = SimpleNamespace(threshold=LEVEL, policy=POLICY, runs=[])
    bent = shaped(0.3, 1e-6)
    assert decide(setup, validated(2e-6, bent)) == "unexplained"  # four fifths of the excess
    assert decide(setup, validated(2e-6, CLEAN)) == "unexplained"  # twice the floor, stated, without a shape
    assert decide(setup, validated(1.1e-6, bent)) == "explained"
    setup.policy = replace(POLICY, minor=0.5)
    assert decide(setup, validated(2e-6, bent)) == "explained"


# -- which of two effects ----------------------------------------------------------------------------------


def effect(name: str, size: int, cost: float, gap: float, ratio: float = 0.5, bic: float = 0.0) -> Exact:
    """An exact refit that leaves squares `cost` of 1000 and the gap metric `gap`."""
    score = Score(
        SimpleNamespace(name=name, separate=()),
        SimpleNamespace(tried=1),
        None,
        1000 - cost,
        size,
        bic,
        ratio,
        1e-9,
    )
    fit = SimpleNamespace(
        cost=cost, metric=gap, readings=1000.0, distance=lambda _: 1.0,
        variance=lambda inflation: inflation * cost / 1000.0,
        base=SimpleNamespace(model=SimpleNamespace(channels=("a", "b"), effects=())),
    )  # fmt: skip
    return Exact(score, fit, bic)


def first(exact: list[Exact], policy: Policy = POLICY) -> str:
    scored = [e.score for e in exact]
    return ordered(exact, scored, lambda _: True, policy)[0].score.effect.name


def test_fewer_parameters_win_if_they_explain_nearly_as_much():
    flexible = effect("flexible", 6, 100.0, 1.0e-6, bic=-90.0)
    plain = effect("plain", 2, 110.0, 1.005e-6, bic=-80.0)
    assert first([flexible, plain]) == "plain"
    assert first([flexible, plain], replace(POLICY, negligible=0.001)) == "flexible"


# -- smaller findings --------------------------------------------------------------------------------------


def test_smaller_findings_are_certain_and_below_the_threshold():
    def scored(name: str, shrinkage: float, p: float) -> Score:
        variant = SimpleNamespace(tried=1)
        return Score(SimpleNamespace(name=name), variant, None, 1.0, 1, 0.0, 1 - shrinkage, p)

    last = [scored("real", 0.03, 1e-6), scored("chance", 0.03, 0.02), scored("large", 0.08, 1e-6)]
    last.append(scored("tiny", 0.004, 1e-6))
    setup = SimpleNamespace(tested=20, threshold=LEVEL, policy=POLICY)
    selection, found = SimpleNamespace(last=last), SimpleNamespace(effects=())
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real"]
    setup.policy = replace(POLICY, certain=0.1)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "chance"]
    setup.policy = replace(POLICY, minor=0.0)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "tiny"]


# -- what is independent, and what its tails are like --------------------------------------------------------


def changed(monkeypatch, module: str, **gates: float) -> None:
    monkeypatch.setattr(sys.modules[f"hallsym.diagnosis.{module}"], "POLICY", replace(POLICY, **gates))


def test_units_are_runs_from_enough_runs_on(monkeypatch):
    assert (stretch(1000, 10), stretch(1000, 24)) == (34, None)
    changed(monkeypatch, "sign_flips", fewest_units=10)
    assert stretch(1000, 10) is None


def test_a_memory_ends_where_it_is_forgotten_and_several_memories_apart_is_independent(monkeypatch):
    colour, run = np.array([1.0, 0.5, 0.1, 0.01]), np.zeros(40, int)
    assert (memory(colour), clusters(run, memories=1.0).max() + 1) == (3.0, 10)
    changed(monkeypatch, "sign_flips", forgotten=0.2, memories=2.0)
    assert (memory(colour), clusters(run, memories=1.0).max() + 1) == (2.0, 20)


def test_noise_with_heavy_tails_has_no_spectrum_to_go_by(monkeypatch):
    white = np.random.default_rng(0).standard_normal((2, 5000))
    piece = SimpleNamespace(used=np.ones(5000, bool), residual=white)
    monkeypatch.setattr(sys.modules["hallsym.diagnosis.spectrum"], "pieces", lambda *_: [piece])
    assert 1.0 <= spectrum_peak(None, ()) < 1.3  # of 20 lags of 10,000 numbers, each to 6 %
    changed(monkeypatch, "spectrum", heavy=2.9)
    assert spectrum_peak(None, ()) == np.inf


def sampled(z: np.ndarray, rest: np.ndarray) -> dict[str, float]:
    """P-values of what single samples are, which move at random speeds; jitter grows with these."""
    size = np.random.default_rng(1).uniform(0.5, 2.0, len(z))
    found = SimpleNamespace(instants=(z * size, size, rest), values=[0, 0], variance=1.0)
    return {f.name: f.p_value for f in of_samples(found)}


def test_tails_of_the_noise_are_expected_to_hold_more_spikes_than_its_body_tells(monkeypatch):
    rng = np.random.default_rng(2)
    rest = rng.standard_normal(4000) ** 2
    rest[500:4000:500] += 100.0
    quiet = rng.standard_normal(4000)
    p = sampled(quiet, rest)["outliers"]
    changed(monkeypatch, "faults", tails=1.0)
    assert sampled(quiet, rest)["outliers"] < 0.1 * p


def test_time_shifts_that_last_are_no_jitter(monkeypatch):
    rng = np.random.default_rng(3)
    shifts, rest = np.repeat(rng.standard_normal(2000), 2), rng.standard_normal(4000) ** 2
    assert "clock_jitter" not in sampled(shifts, rest)
    assert "clock_jitter" in sampled(rng.permutation(shifts), rest)
    changed(monkeypatch, "faults", smooth=0.9)
    assert "clock_jitter" in sampled(shifts, rest)


# -- input -------------------------------------------------------------------------------------------------


def runs_of(count: int) -> Log:
    """So many runs of an encoder without a cause, no holdout runs named."""
    whole = machine()
    keep = whole.array("run") < count
    return Log.from_arrays({c: whole.array(c)[keep] for c in whole.columns}, whole.noise)


def test_the_threshold_and_the_holdout_runs_follow_the_policy():
    setup = prepare(runs_of(8), "ellipse")
    assert (setup.threshold, setup.holdout, setup.split) == (POLICY.worth_reporting, (2, 7), False)
    other = replace(POLICY, worth_reporting=0.2, holdout_every=3)
    setup = prepare(runs_of(8), "ellipse", policy=other)
    assert (setup.threshold, setup.holdout) == (0.2, (1, 4, 7))


# -- whole diagnoses, with the policy and with one threshold switched off -----------------------------------


def without(log: Log, model: str, **gates: float) -> tuple[Diagnosis, Diagnosis]:
    """Return the diagnosis with the policy and with some thresholds replaced."""
    return diagnose(log, model), diagnose(log, model, policy=replace(POLICY, **gates))


@pytest.mark.slow
def test_two_plain_effects_win_against_a_flexible_one(monkeypatch):
    """One harmonic, an offset and a gain mismatch: a tilt of the magnet would take all along."""
    kept = diagnose(machine(third), "rotary_ideal")
    monkeypatch.setattr(SELECTION, "plain_pairs_first", lambda exact, *_: exact)
    off = diagnose(machine(third), "rotary_ideal")
    assert kept.verdict == "explained"
    assert "third_harmonic_distortion" in kept.ranked
    assert off.ranked[0] == "magnet_tilt"  # what else it lists is its residue
    assert off.metric.after > 1.5 * kept.metric.after


@pytest.mark.parametrize(
    ("text", "undone"), [("even_nonlinearity", False), ("even_nonlinearity:order=4", True)]
)
def test_an_effect_whose_parameters_undo_each_other_is_rejected(text, undone):
    """Where the data ask for neither, a square and a fourth power grow until they cancel."""
    setup = prepare(table(LIKE_A_TABLE), "rotary")
    wide = effect_named(text, setup.base.model).added(setup.base.model, text)
    fit = refit(with_model(setup.base, wide), setup.runs)
    assert cancels(fit, [n for n in wide.names if n not in setup.base.model.names], POLICY.half) is undone


@pytest.mark.slow
@pytest.mark.parametrize("gate", ["most_refits", "half"])
def test_effects_that_explain_nearly_as_much_are_refitted_too(gate):
    setup = prepare(machine(third), "ellipse")
    (kept,), (off,) = (
        select(replace(setup, policy=policy)).effects for policy in (POLICY, replace(POLICY, **{gate: 1}))
    )
    alike = {kept.name, *(r.name for r in kept.rivals)}
    assert alike == {"third_harmonic_distortion", "field_saturation", "odd_nonlinearity"}
    assert off.rivals == ()


@pytest.mark.slow
def test_a_rail_is_refitted_from_several_starts():
    log = stage("raster", (listed(np.random.default_rng(1))["saturation"],), seed=1, thin=6)
    kept, off = without(log, "stage31", starts=1)
    assert kept.metric.after < 1.1 * kept.metric.floor
    assert off.metric.after > 1.5 * off.metric.floor
