"""Results that must stay as they are, whatever is moved or renamed (see regenerate.py).

Everything is reached by the public names of `hallsym` and the command line.
"""

import json
from pathlib import Path

import pytest
from golden_compare import differences
from golden_results import GOLDENS

HERE = Path(__file__).resolve().parent
OLD = {"parameters": {"a": {"value": 1.0, "std": 1e-2}}, "verdict": "explained", "list": [1.0, 2.0]}


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] if g.slow else []) for n, g in GOLDENS.items()]
)
def test_result_is_the_golden_one(name):
    old = json.loads((HERE / f"{name}.json").read_text(encoding="utf-8"))
    found = list(differences(old, GOLDENS[name].make(), GOLDENS[name].kind))
    assert not found, "\n".join([f"{name} is not what it was:", *found[:40]])


def test_every_stored_golden_is_made_and_compared():
    stored = {f"{k}/{p.stem}" for k in ("fit", "diagnosis", "code") for p in (HERE / k).glob("*.json")}
    assert stored == set(GOLDENS)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"parameters": {"a": {"value": 1.0 + 2e-8, "std": 1e-2}}}, "parameters.a.value: was 1.0"),
        ({"verdict": "no gap"}, "verdict: was 'explained', is 'no gap'"),
        ({"list": [1.0]}, "list: 2 entries"),
        ({"more": 1}, ": key 'more' is new"),
        ({"list": [1.0, None]}, "list[1]: was 2.0, is None"),
        ({"list": [1.0, float("nan")]}, "list[1]: was 2.0, is nan"),
    ],
)
def test_a_difference_names_the_key_and_both_values(changed, said):
    (found,) = differences(OLD, {**OLD, **changed}, "fit")
    assert found.startswith(said)
    assert not list(differences(OLD, {**OLD, "list": [1.0, 2.0 + 1e-8]}, "fit"))
