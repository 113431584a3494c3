"""The link of the chain that a gap lies in, and how large it is: named where it is put, silent on noise."""

import sys
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from gap_twins import listed, machine, unlisted
from test_diagnosis_where import NOISES, base_on, stated
from twins import record

from hallsym.diagnosis import Base, diagnose
from hallsym.diagnosis.decoded_errors import decoded_errors
from hallsym.diagnosis.facts import facts_of
from hallsym.diagnosis.localisation import Located, located, sizes
from hallsym.diagnosis.residual_table import both, table_of
from hallsym.diagnosis.scores import Screen, candidates
from hallsym.diagnosis.survey import survey
from hallsym.errors import InputError
from hallsym.families import effects
from hallsym.families.stage import FAMILY as STAGE_FAMILY
from hallsym.log import Log
from hallsym.log.core import Drop, without
from hallsym.model import Effect, Model, Parameter
from hallsym.model.effect import as_effect

CATALOGUE = tuple(e for e in effects(STAGE_FAMILY).values() if e.diagnosed)
FEWER = ("odd_nonlinearity", "time_skew", "hysteresis", "reference_drift", "vertical_offset_coupling",
         "height_quadratic", "mains_hum", "first_order_lag")  # fmt: skip
"""Effects of every link, enough to tell them apart."""


def fitted_runs(base: Base) -> list[int]:
    return [run for run in base.log.runs if run not in base.holdout]


def screened(base: Base, effects: tuple[Effect, ...]) -> Screen:
    runs = fitted_runs(base)
    seen = survey(base, frozenset(runs))
    tried, _ = candidates(base, effects, facts_of(base, seen))
    screen = Screen(base, tried, runs)
    screen.weigh(seen.autocorrelation)
    return screen


def some() -> tuple[Effect, ...]:
    return tuple(e for e in CATALOGUE if e.name in FEWER)


@cache
def found(name: str) -> tuple[Base, Located]:
    log = machine("grid", (listed(np.random.default_rng(1))[name],), seed=1, thin=6)
    base = base_on(log)
    return base, located(base, log.runs, screened(base, some()))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "link"), [("odd_nonlinearity", "field"), ("height_quadratic", "transducer")]
)
def test_the_link_is_the_one_that_the_gap_was_put_in(name: str, link: str) -> None:
    _, here = found(name)
    first = next(s for s in here.statements if s.by == "link")
    assert (first.at, name in first.text) == (link, True)
    assert first.share > 0.9
    assert first.p_value < 0.01


@pytest.mark.slow
def test_a_table_holds_an_even_part_of_a_long_log(monkeypatch: pytest.MonkeyPatch) -> None:
    base, _ = found("odd_nonlinearity")
    module = sys.modules[table_of.__module__]
    assert module.ROOM >= 50_000  # 57 runs of 900 samples, whole
    whole = table_of(base, frozenset(base.log.runs))
    monkeypatch.setattr(module, "ROOM", base.log.rows // 5)
    part = table_of(base, frozenset(base.log.runs))
    assert whole is not None
    assert part is not None
    assert whole.residual.shape[1] == base.log.rows
    assert part.residual.shape[1] <= base.log.rows / 5 + len(base.log.runs)
    assert set(part.run) == set(whole.run)
    each = [table.excess / table.residual.size for table in (part, whole)]
    assert each[0] == pytest.approx(each[1], rel=0.2)


def test_an_effect_of_a_user_counts_for_the_link_that_it_changes() -> None:
    def cubic(model: Model) -> Model:
        size = Parameter("own_cubic", 0.0, -1e8, 1e8, "1/m2")

        def step(s, p):
            s["displacement"] = s["displacement"] + p["own_cubic"] * s["displacement"] ** 3

        return model.with_step("field", step, effect="own_cubic", parameters=(size,))

    base, _ = found("odd_nonlinearity")
    here = located(base, base.log.runs, screened(base, (as_effect(cubic),)))
    (link,) = [s for s in here.statements if s.by == "link"]
    assert link.at == "field"
    assert link.share > 0.5
    assert "another link: none tested" in link.text


@pytest.mark.slow
@pytest.mark.parametrize("kind", NOISES)
def test_noise_gets_no_statement_of_a_link_an_output_or_a_sensor(kind: str) -> None:
    """Noise that is larger than stated: there is an excess, but in no link."""
    log = Log.from_arrays(record(seed=5, samples=24, **NOISES[kind]), noise=stated(0.85))
    base = base_on(log)
    here = located(base, log.runs, screened(base, some()))
    assert [s for s in here.statements if s.by in ("link", "output", "sensor")] == []


def test_sizes_are_those_of_the_decoded_pose_and_of_the_readings() -> None:
    base, _ = found("odd_nonlinearity")
    sides = {"fitted": fitted_runs(base), "held_out": sorted(base.holdout)}
    errors = {k: decoded_errors(base, runs) for k, runs in sides.items()}
    floor = {"x_m": 1e-6, "y_m": 0.5e-6, "rz_rad": 2e-6}
    fitted, held = both(base, base.log.runs)
    size = sizes({"fitted": fitted, "held_out": held}, errors, dict.fromkeys(sides, floor))
    for side in sides:
        rows = {c: sides_[side] for c, sides_ in size.outputs.items()}
        assert {c: r.rms for c, r in rows.items()} == pytest.approx(errors[side].gap.rmse)
        assert {c: r.noise for c, r in rows.items()} == floor
        for r in (*rows.values(), *(s[side] for s in size.sensors.values())):
            assert r.above**2 == pytest.approx(max(r.rms**2 - r.noise**2, 0.0))
        for kind in (size.outputs, size.sensors):
            assert sum(s[side].share for s in kind.values()) == pytest.approx(1.0)
    total, count = np.zeros(3), 0
    for block in base.log.blocks():
        if block.run in base.holdout:
            pose, state = ([block.data[c] for c in n] for n in (base.model.references, base.model.state))
            expected = base.model.readings(base.p, pose, state, base.offsets[block.run])
            left = np.array([block.data[c] for c in base.model.channels]) - expected
            total, count = total + (left**2).sum(axis=1), count + left.shape[1]
    seen = [size.sensors[c]["held_out"].rms for c in base.model.channels]
    np.testing.assert_allclose(seen, np.sqrt(total / count), rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ringing", "screw"])
def test_a_backlash_beside_what_no_catalogue_lists_is_not_the_whole_of_it(name: str) -> None:
    """Play of a drive needs columns that a model computes; beside it every other gap is still told."""
    seed = 100 + list(unlisted(np.random.default_rng(0))).index(name)
    listing, others = (make(np.random.default_rng(seed)) for make in (listed, unlisted))
    found = diagnose(machine("raster", (listing["hysteresis"], others[name]), seed=seed, thin=3))
    as_noise = found.verdict == "explained" and "the rest depends on no logged quantity" in found.sentence
    assert "hysteresis" in {*found.ranked, *(n for g in found.groups for n in g)}
    assert found.verdict == "unexplained" or as_noise


def test_errors_of_some_runs_are_those_of_a_log_of_these_runs_alone() -> None:
    """A run that is not asked for is not decoded: one without a pose is no fault of the others."""
    base, _ = found("odd_nonlinearity")
    runs = sorted(base.holdout)
    wanted = frozenset(runs)
    short = replace(base, log=without(base.log, Drop(runs=frozenset(base.log.runs) - wanted)))
    some, alone = decoded_errors(base, runs), decoded_errors(short, runs)
    assert some.count == alone.count == sum(len(b.data["t_s"]) for b in short.log.blocks())
    assert some.rms == pytest.approx(alone.rms, rel=1e-12)
    assert some.peak == pytest.approx(alone.peak, rel=1e-12)
    lost = replace(
        base, offsets={**base.offsets, fitted_runs(base)[0]: np.full(len(base.model.offsets), np.nan)}
    )
    assert decoded_errors(lost, runs).count == some.count
    with pytest.raises(InputError, match="give no pose"):
        decoded_errors(lost, base.log.runs)
