"""Every threshold of the policy decides something: each has a test here that fails without it.

A stage is a function of records, so most tests give it small records made by hand. The others diagnose small
simulated logs twice, with the policy and with one threshold switched off.
"""

import sys
from collections.abc import Callable
from dataclasses import fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from gap_twins import listed
from gap_twins import machine as stage
from scipy.signal import lfilter
from test_diagnosis_rotary import machine, third
from test_diagnosis_turn import LIKE_A_TABLE, table
from test_survey import encoder

from hallsym.diagnosis import POLICY, Base, Diagnosis, diagnose, prepare
from hallsym.diagnosis.curves import LackOfFit, Shape
from hallsym.diagnosis.facts import facts_of, switched_runs
from hallsym.diagnosis.faults import of_samples
from hallsym.diagnosis.localisation import clear
from hallsym.diagnosis.p_values import memory
from hallsym.diagnosis.policy import Policy
from hallsym.diagnosis.refit import refit, with_model
from hallsym.diagnosis.report import confusable, smaller_findings
from hallsym.diagnosis.residual_table import residual_table
from hallsym.diagnosis.scores import Score
from hallsym.diagnosis.selection import Exact, Selection, cancels, ordered, refitted
from hallsym.diagnosis.setup import Floor, Setup
from hallsym.diagnosis.survey import spectrum_peak, survey
from hallsym.diagnosis.validation import decide, remains, unfounded
from hallsym.families import effect_named
from hallsym.log import Log
from hallsym.report.results.diagnosis import shrinks_text

SELECTION = sys.modules["hallsym.diagnosis.selection"]
"""The module whose functions a test replaces."""

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
    setup, of = SimpleNamespace(threshold=LEVEL, policy=POLICY), SimpleNamespace(floor=FLOOR, error=error)
    assert remains(setup, of, found, excess * FLOOR.metric) is gap
    if found is CLEAN:
        of.floor = replace(FLOOR, uncertain=2.0)
        assert not remains(setup, of, found, excess * FLOOR.metric)
        assert remains(setup, of, found, 2 * excess * FLOOR.metric) is gap


def validated(after: float, rest: LackOfFit) -> SimpleNamespace:
    """A validation that names an effect which lowers a gap of 4 um to `after`."""
    end = object()
    return SimpleNamespace(
        named=True, metric=after, before=SimpleNamespace(metric=4e-6), base=end, end=end, rest=rest,
        floor=FLOOR, error=0.0,
    )  # fmt: skip


def test_a_gap_is_explained_only_where_the_rest_is_at_the_floor():
    setup = SimpleNamespace(threshold=LEVEL, policy=POLICY, runs=[])
    bent = shaped(0.3, 1e-6)
    assert decide(setup, validated(1.3e-6, bent)) == "unexplained"  # 99 % of the excess is closed
    assert decide(setup, validated(1.1e-6, bent)) == "explained"
    assert decide(setup, validated(2e-6, CLEAN)) == "unexplained"  # twice the floor, stated, without a shape
    assert decide(setup, validated(1.05e-6, CLEAN)) == "explained"
    setup.policy = replace(POLICY, half=0.1)
    assert decide(setup, validated(1.1e-6, bent)) == "unexplained"
    setup.policy = replace(POLICY, minor=1e-3)
    assert decide(setup, validated(1.1e-6, bent)) == "unexplained"


def test_the_reference_is_to_blame_only_for_more_than_is_left():
    assert not unfounded(2.0, 1.4, 1.0, POLICY)  # 2.04 of an excess of 3
    assert unfounded(2.0, 1.6, 1.0, POLICY)  # 1.44
    assert not unfounded(2.0, 1.6, 1.0, replace(POLICY, half=0.3))


# -- which of two effects ----------------------------------------------------------------------------------


def effect(
    name: str,
    size: int,
    cost: float,
    gap: float,
    ratio: float = 0.5,
    bic: float = 0.0,
    policy: Policy = POLICY,
) -> Exact:
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
        base=SimpleNamespace(
            model=SimpleNamespace(channels=("a", "b"), effects=()), values={}, policy=policy
        ),
    )  # fmt: skip
    return Exact(score, fit, bic)


def first(policy: Policy, variant_bic: float | None = None) -> str:
    """Which of a flexible and a plain effect goes first; the flexible one may have a variant as plain."""
    flexible = effect("flexible", 6, 100.0, 1.0e-6, bic=-90.0, policy=policy)
    plain = effect("plain", 2, 110.0, 1.005e-6, bic=-80.0, policy=policy)
    scored = [flexible.score, plain.score]
    if variant_bic is not None:
        scored.append(replace(flexible.score, size=2, bic=variant_bic))
    return ordered([flexible, plain], scored)[0].score.effect.name


def test_fewer_parameters_win_if_they_explain_nearly_as_much():
    assert first(POLICY) == "plain"
    assert first(replace(POLICY, negligible=0.001)) == "flexible"
    assert first(POLICY, -75.0) == "flexible"
    assert first(replace(POLICY, as_good=1.0), -75.0) == "plain"


# -- smaller findings --------------------------------------------------------------------------------------


def test_smaller_findings_are_certain_and_below_the_threshold():
    def scored(name: str, shrinkage: float, p: float) -> Score:
        variant = SimpleNamespace(tried=1)
        link = "reference" if name == "accused" else "field"
        return Score(SimpleNamespace(name=name, link=link), variant, None, 1.0, 1, 0.0, 1 - shrinkage, p)

    last = [scored("real", 0.03, 1e-6), scored("chance", 0.03, 0.02), scored("large", 0.08, 1e-6)]
    last += [scored("tiny", 0.004, 1e-6), scored("accused", 0.03, 1e-6)]  # 6 % of squares, of 31 % excess
    setup = SimpleNamespace(tested=20, threshold=LEVEL, policy=POLICY, floor_fitted=FLOOR)
    fit = SimpleNamespace(metric=1.2 * FLOOR.metric)
    selection, found = SimpleNamespace(last=last, fit=fit), SimpleNamespace(effects=())
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real"]
    setup.policy = replace(POLICY, certain=0.1)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "chance"]
    setup.policy = replace(POLICY, minor=0.0)
    assert [f.name for f in smaller_findings(setup, selection, found)] == ["real", "tiny"]


# -- what is independent, and what its tails are like --------------------------------------------------------


def test_noise_that_lasts_for_a_run_has_a_spectrum_of_its_own_there(monkeypatch):
    """First order with a memory of a run, a fifth of the power: few lags see little of it beside offsets."""
    rng, n = np.random.default_rng(1), 500
    a = np.exp(-1 / n)
    slow = lfilter([np.sqrt(0.2 * (1 - a * a))], [1, -a], rng.standard_normal((60, 2, 6 * n)))[..., -n:]
    noise = rng.standard_normal((60, 2, n)) + slow
    made = [SimpleNamespace(used=np.ones(n, bool), residual=x - x.mean(axis=1)[:, None]) for x in noise]
    monkeypatch.setattr(sys.modules["hallsym.diagnosis.survey"], "pieces", lambda *_: made)
    lag = (np.arange(n) + 0.5) / n
    expected = 1 + 0.2 * n * 2 * np.mean((1 - lag) * np.exp(-lag) * np.cos(2 * np.pi * lag))
    assert spectrum_peak(SimpleNamespace(policy=POLICY), ()) == pytest.approx(expected, rel=0.25)


def sampled(z: np.ndarray, rest: np.ndarray, policy: Policy = POLICY) -> dict[str, float]:
    """P-values of what single samples are, which move at random speeds; jitter grows with these."""
    size = np.random.default_rng(1).uniform(0.5, 2.0, len(z))
    found = SimpleNamespace(instants=(z * size, size, rest), adc_step=[0, 0], variance=1.0)
    return {f.name: f.p_value for f in of_samples(found, policy)}


def spiky() -> tuple[np.ndarray, np.ndarray]:
    """Samples of which seven are spikes."""
    rng = np.random.default_rng(2)
    rest = rng.standard_normal(4000) ** 2
    rest[500:4000:500] += 100.0
    return rng.standard_normal(4000), rest


def test_time_shifts_that_last_are_no_jitter():
    rng = np.random.default_rng(3)
    shifts, rest = np.repeat(rng.standard_normal(2000), 2), rng.standard_normal(4000) ** 2
    assert "clock_jitter" not in sampled(shifts, rest)
    assert "clock_jitter" in sampled(rng.permutation(shifts), rest)
    assert "clock_jitter" in sampled(shifts, rest, replace(POLICY, smooth=0.9))


@pytest.mark.parametrize("one_sided", [True, False])
def test_late_samples_are_all_late_and_noise_is_as_often_early(one_sided):
    """One sample in twenty-five is far off, by anything from 6 to 30 standard deviations."""
    rng = np.random.default_rng(4)
    z, rest = rng.standard_normal(4000), rng.standard_normal(4000) ** 2
    off = rng.uniform(6.0, 30.0, 160)
    z[::25] = off if one_sided else off * rng.choice([-1.0, 1.0], 160)
    rest[50::500] += 100.0  # a few of them across the motion
    found = sampled(z, rest)
    assert ("outliers" in found) != one_sided
    assert found.get("dropped_samples", 1.0) < 1e-20 if one_sided else "dropped_samples" not in found


def test_eight_late_samples_are_certain_by_their_size():
    """By their signs alone they are a chance of one in 128."""
    rng = np.random.default_rng(5)
    z, rest = rng.standard_normal(4000), rng.standard_normal(4000) ** 2
    z[250::500] = rng.uniform(20.0, 50.0, 8)
    assert sampled(z, rest)["dropped_samples"] < 1e-6
    z[250::1000] *= -1
    assert "dropped_samples" not in sampled(z, rest)


# -- input -------------------------------------------------------------------------------------------------


def runs_of(count: int) -> Log:
    """So many runs of an encoder without a cause, no holdout runs named."""
    whole = machine()
    keep = whole.array("run") < count
    return Log.from_arrays({c: whole.array(c)[keep] for c in whole.columns}, whole.noise)


# -- every threshold of a diagnosis is that of the policy it was given --------------------------------------


def of_setup(look: Callable[[Setup], Any]) -> Callable[[Policy], Any]:
    """Return what `look` sees in a machine with a third harmonic, prepared with a policy."""
    return lambda policy: look(prepare(machine(third), "ellipse", policy=policy))


def of_base(look: Callable[[Base, frozenset[int]], Any]) -> Callable[[Policy], Any]:
    """Return what `look` sees in the fit of that machine and its fitted runs."""
    return of_setup(lambda setup: look(setup.base, frozenset(setup.runs)))


def search(setup: Setup) -> Selection:
    start = refit(setup.base, setup.runs)
    return Selection(setup, start, start, {(): start})


def refits(policy: Policy) -> int:
    """How many starts of ten effects are refitted, five of each."""
    made = [effect(str(k), 1, 100.0, 1e-6, policy=policy) for k in range(10)]
    for e in made:
        e.score.effect.possible, e.score.variant.tried = lambda _: True, 9
    count = list[int]()

    def fitted(*_: Any) -> SimpleNamespace:
        count.append(1)
        return SimpleNamespace(**vars(made[0].fit), bic=lambda size: 0.0)

    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(SELECTION, "with_model", lambda base, model: base)
        patched.setattr(SELECTION, "refit", fitted)
        screen = SimpleNamespace(scores=[e.score for e in made for _ in range(5)], refits={})
        refitted(made[0].fit.base, screen, (), lambda _: True)
    return len(count)


def not_told_apart(policy: Policy) -> tuple[str, ...]:
    """What is confusable with an effect of which another leaves 3 standard deviations more."""
    base = SimpleNamespace(model=SimpleNamespace(pose=("x_m",), family=SimpleNamespace(pairs=False)))
    one = replace(effect("one", 1, 100.0, 1e-6), rivals=(effect("other", 1, 101.0, 1e-6),))
    found = SimpleNamespace(inflation=1.0, effects=[SimpleNamespace(name="one", exact=one)])
    return confusable(SimpleNamespace(policy=policy, base=base), found, (), "explained").ranked


CHANGES: dict[str, tuple[float, Callable[[Policy], Any]]] = {
    "false_alarm": (0.0, of_setup(lambda s: search(s).worth(SimpleNamespace(p_value=0.03, ratio=0.5), 0))),
    "certain": (0.0, of_base(lambda base, runs: clear(residual_table(base, runs)))),
    "negligible": (1e6, of_setup(lambda setup: search(setup).needed())),
    "minor": (1.0, of_base(lambda base, runs: survey(base, runs).adc_step.any())),
    "half": (1.0, of_setup(lambda s: search(s).worth(SimpleNamespace(p_value=0.0, ratio=0.97), 0))),
    "fewest": (100, of_base(lambda base, _: switched_runs(residual_table(base, base.log.runs)))),
    "fewest_units": (2, of_base(lambda base, runs: residual_table(base, runs).block.max())),
    "forgotten": (2.0, of_base(lambda base, runs: memory(survey(base, runs).autocorrelation, base.policy))),
    "memories": (8.0, lambda policy: len(prepare(encoder(runs=1, samples=2000), policy=policy).log.runs)),
    "heavy": (1.0, of_base(spectrum_peak)),
    "tails": (1.0, lambda policy: sampled(*spiky(), policy)),
    "smooth": (-1.0, lambda policy: sampled(*spiky(), policy)),
    "worth_reporting": (0.2, of_setup(lambda setup: setup.threshold)),
    "holdout_every": (3, lambda policy: prepare(runs_of(8), "ellipse", policy=policy).holdout),
    "rail_repeats": (1, of_base(lambda base, runs: facts_of(base, survey(base, runs)).rails)),
    "most_refits": (1, refits),
    "starts": (1, refits),
    "as_good": (1.0, lambda policy: first(policy, -75.0)),
    "separated": (1.0, not_told_apart),
}
"""For each threshold another value, and what that changes."""


@pytest.mark.parametrize("name", [field.name for field in fields(Policy)])
def test_every_threshold_is_read_from_the_policy_that_was_given(name):
    value, decided = CHANGES[name]
    assert decided(POLICY) != decided(replace(POLICY, **{name: value}))


def test_a_report_says_below_how_many_runs_there_is_no_interval():
    found = diagnose(machine(third), "ellipse", policy=replace(POLICY, fewest=50))
    assert found.shrinkage.interval is None
    again = Diagnosis.from_dict(found.to_dict())
    assert "no 95 % interval: it needs at least 50 runs" in shrinks_text(again)


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
    new = [n for n in wide.names if n not in setup.base.model.names]
    assert cancels(fit, new) is undone
    units = (replace(q, unit=q.name) if q.name in new else q for q in fit.base.model.parameters)
    apart = replace(fit.base.model, parameters=tuple(units))
    assert not cancels(replace(fit, base=replace(fit.base, model=apart)), new)  # no two of one unit


@pytest.mark.slow
def test_a_rail_is_refitted_from_several_starts():
    log = stage("raster", (listed(np.random.default_rng(1))["saturation"],), seed=1, thin=6)
    kept, off = without(log, "stage31", starts=1)
    assert kept.metric.after < 1.1 * kept.metric.floor
    assert off.metric.after > 1.5 * off.metric.floor
