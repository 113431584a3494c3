"""Effects are searched on a part of a long log; what is found is fitted to and judged on all samples."""

import sys

import numpy as np
import pytest
from twins import SIGMAS, record, with_noise

from hallsym.diagnosis import Diagnosis, diagnose
from hallsym.families import build
from hallsym.log import Log
from hallsym.log.batches import batches
from hallsym.log.derived import HALO, extended
from hallsym.log.part import LENGTH, part_of
from hallsym.model.derived import campaign_time, rate, run_time

SAMPLES, SHARE = 400, 3


def bent(cubic: float) -> Log:
    """The twin's campaign, one reading with a cubic error of this size [m]."""
    columns = record(seed=3, samples=SAMPLES)
    x = columns["hall_a_m"] / np.std(columns["hall_a_m"])
    return with_noise(columns | {"hall_a_m": columns["hall_a_m"] + cubic * x**3}, SIGMAS)


def searched(log: Log, rows: int, monkeypatch: pytest.MonkeyPatch) -> Diagnosis:
    """Diagnose with a search on so many samples at most."""
    for module, name in (("diagnosis.residuals", "CACHED_ROWS"), ("diagnosis.residuals", "PART")):
        monkeypatch.setattr(sys.modules[f"hallsym.{module}"], name, rows)
    monkeypatch.setattr(sys.modules["hallsym.log.part"], "LENGTH", 60)
    return diagnose(log)


@pytest.mark.slow
def test_a_search_on_a_part_says_of_all_samples_what_a_whole_one_says(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    log = bent(1.5e-6)
    whole, part = (searched(log, rows, monkeypatch) for rows in (log.rows, log.rows // SHARE))
    assert part.ranked == whole.ranked == ("odd_nonlinearity",)
    assert part.verdict == whole.verdict
    assert any(f"of its {log.rows} samples" in note for note in part.notes)
    assert not any("searched on" in note for note in whole.notes)
    for name in ("before", "after", "floor"):
        assert getattr(part.metric, name) == pytest.approx(getattr(whole.metric, name), rel=1e-4)
    assert part.shrinkage.interval == pytest.approx(whole.shrinkage.interval, abs=2e-3)
    (one,), (other,) = part.effects, whole.effects
    for name, estimate in one.parameters.items():
        known = other.parameters[name]
        assert abs(estimate.value - known.value) < 0.02 * known.std
        assert estimate.std == pytest.approx(known.std, rel=0.02)


def test_a_part_is_whole_stretches_whose_derived_columns_are_those_of_the_log() -> None:
    rng, counts = np.random.default_rng(5), (9000, 200, 20_000, 700)
    t = [100.0 * k + 1e-3 * np.arange(n) for k, n in enumerate(counts)]
    columns = {"run": np.repeat(range(len(counts)), counts), "t_s": np.concatenate(t)}
    log = Log.from_arrays(columns | {"x_ref_m": rng.standard_normal(sum(counts))})
    part = part_of(log, 10_000, HALO)
    made = (campaign_time(), run_time(), rate("x_ref_m", 2))
    model, sigma = build("stage31").with_columns(*made), {"x_ref_m": 1.0}
    names = ("t_s", "x_ref_m", *(c.name for c in made))
    both = [
        {c: np.concatenate([b.data[c] for b in batches(extended(of, model, sigma), names)]) for c in names}
        for of in (log, part)
    ]
    at = np.searchsorted(both[0]["t_s"], both[1]["t_s"])
    assert 0.8 < len(at) / 10_000 < 1.2
    for name in names[:-1]:
        np.testing.assert_array_equal(both[1][name], both[0][name][at])
    # the window of a rate is chosen on the first stretch of a run; one that is as wide gives the same rate
    same = np.abs(both[1][names[-1]] - both[0][names[-1]][at]) < 1e-6 * np.std(both[0][names[-1]])
    assert same.mean() > 0.5
    steps = np.diff(at)
    assert (steps > 0).all()
    assert (steps > 1).sum() < 1.2 * len(at) / min(LENGTH, *counts)  # the full rate, but between stretches
    assert set(part.runs) <= set(log.runs)
    assert {0, 2} <= set(part.runs)
