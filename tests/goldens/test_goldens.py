"""Results that must stay as they are, whatever is moved or renamed (see regenerate.py).

Everything is reached by the public names of `hallsym` and the command line.
"""

import json
from difflib import unified_diff
from pathlib import Path

import pytest
from golden_compare import differences
from golden_logs import LOGS, Absent
from golden_results import GOLDENS

HERE = Path(__file__).resolve().parent
SHOWN = 40


def listed() -> list:
    return [pytest.param(n, marks=[pytest.mark.slow] if g.slow else []) for n, g in GOLDENS.items()]


def texts_beside(old: dict, new: dict) -> list[str]:
    """The lines of kept texts that differ."""
    found = []
    for path in old.keys() & new.keys():
        found += unified_diff(old[path], new[path], f"old/{path}", f"new/{path}", lineterm="", n=1)
    return found


@pytest.mark.parametrize("name", listed())
def test_result_is_the_golden_one(name):
    old = json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))
    try:
        new = GOLDENS[name].make()
    except Absent as absent:
        pytest.skip(str(absent))
    found = []
    if name.startswith("code/"):
        found = texts_beside(old.pop("texts"), new.pop("texts"))
    found += differences(old, new, GOLDENS[name].kind)
    more = [f"... and {len(found) - SHOWN} more"] if len(found) > SHOWN else []
    assert not found, "\n".join([f"{name} is not what it was:", *found[:SHOWN], *more])


def test_every_stored_golden_is_made_and_compared():
    stored = {str(p.relative_to(HERE).with_suffix("")) for k in ("fit", "diagnosis", "json", "code")
              for p in (HERE / k).glob("*.json")}  # fmt: skip
    assert stored == set(GOLDENS)


def test_a_case_beside_the_project_has_a_simulated_log_that_stands_for_it():
    for name, log in LOGS.items():
        if log.like:
            assert LOGS[log.like].like is None, name
            assert f"fit/{log.like}" in GOLDENS
            assert f"diagnosis/{log.like}" in GOLDENS


# -- the comparison itself ---------------------------------------------------------------------------------

OLD = {"parameters": {"a": {"value": 1.0, "std": 1e-2}}, "verdict": "explained", "list": [1.0, 2.0]}


@pytest.mark.parametrize(
    ("kind", "new", "said"),
    [
        (
            "fit",
            {**OLD, "parameters": {"a": {"value": 1.0 + 2e-8, "std": 1e-2}}},
            "parameters.a.value: was 1.0",
        ),
        ("fit", {**OLD, "verdict": "no gap"}, "verdict: was 'explained', is 'no gap'"),
        ("json", {**OLD, "list": [1.0]}, "list: 2 entries"),
        ("json", {**OLD, "more": 1}, "key 'more' is new"),
        ("json", {k: v for k, v in OLD.items() if k != "list"}, "key 'list' is gone"),
        ("json", {**OLD, "list": [1.0, None]}, "list[1]: was 2.0, is None"),
    ],
)
def test_a_difference_names_the_key_and_both_values(kind, new, said):
    (found,) = differences(OLD, new, kind)
    assert found.startswith(said) or said in found


def test_what_is_allowed_is_no_difference():
    new = {**OLD, "parameters": {"a": {"value": 1.0 + 9e-9, "std": 1e-2}}}
    assert not list(differences(OLD, new, "fit"))
    p = {"p_value": 1e-6}, {"p_value": 2e-6}
    assert not list(differences(*p, "diagnosis"))
    assert list(differences({"p_value": 1e-6}, {"p_value": 1e-5}, "diagnosis"))
    recipe = {"text": "hysteresis:half_width_m=6e-05"}, {"text": "hysteresis:half_width_m=6.0001e-05"}
    assert not list(differences(*recipe, "diagnosis"))
