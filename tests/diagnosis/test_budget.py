"""A budget ends the search of a diagnosis: what was found by then is a diagnosis, and says so."""

import json
from pathlib import Path

import pytest

import hallsym
from hallsym.diagnosis import diagnose
from hallsym.diagnosis import setup as preparing
from hallsym.diagnosis.selection import Selection
from hallsym.log import read_log

CAMPAIGN = Path(__file__).parents[2] / "data" / "campaign"


def test_no_budget_is_a_valid_diagnosis_of_the_first_pass() -> None:
    found = diagnose(read_log(CAMPAIGN), "stage30", budget=0)
    assert found.verdict == "unexplained"
    assert not found.effects
    (note,) = (n for n in found.notes if n.startswith("The search stopped"))
    assert "budget of 0 s" in note
    assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["verdict"] == found.verdict


@pytest.mark.slow
def test_the_search_ends_where_the_clock_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """The clock jumps once an effect was found: it is kept, and no other is sought."""
    now, grow = [0.0], Selection.step

    def step(self: Selection, *of: object, **by: object) -> object:
        found = grow(self, *of, **by)  # type: ignore[arg-type]
        now[0] += 100.0
        return found

    monkeypatch.setattr(preparing, "perf_counter", lambda: now[0])
    monkeypatch.setattr(Selection, "step", step)
    found = diagnose(read_log(CAMPAIGN), "stage30", budget=50)
    assert found.verdict == "explained"
    assert found.ranked == ("vertical_gain_coupling",)
    assert sum("The search stopped for its budget of 50 s" in n for n in found.notes) == 1


def test_a_negative_budget_is_refused() -> None:
    with pytest.raises(hallsym.InputError, match="budget of diagnose must be 0 s or more"):
        diagnose(read_log(CAMPAIGN), budget=-1)
