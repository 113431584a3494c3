"""A reference that is homed anew between runs: each run has a zero of its own.

Facts: turning the reference of a run changes nothing but that run's zero; the zeros that were drawn.
"""

import numpy as np
import pytest

import hallsym
from hallsym.log import Log, Noise, wrapped

TURN = 2 * np.pi
TRUTH = {"Vx": 0.0189, "Vy": 0.0105, "Ax": 1.0286, "Ay": 0.9945, "beta": 0.00368}
HOMES = (0.6, -2.4, 2.1, 0.7, -0.9, 3.0)
OWN = ("zero_deviation",)


def recorded(homes=HOMES, decoded=False, seed=1, sigma=3.5e-4, reference=2e-5, turns=2.2):
    """Runs of 250 samples, there and back; the reference of each begins at a zero of its own."""
    rng, rows = np.random.default_rng(seed), []
    for run, home in enumerate(homes):
        a = rng.uniform(0, TURN) + (-1) ** run * turns * TURN * np.arange(250) / 250
        y = TRUTH["Vy"] + TRUTH["Ay"] * np.sin(a + TRUTH["beta"]) + sigma * rng.standard_normal(250)
        x = TRUTH["Vx"] + TRUTH["Ax"] * np.cos(a) + sigma * rng.standard_normal(250)
        logged = np.mod(a - home + reference * rng.standard_normal(250), TURN)
        rows.append((np.full(250, run), 2 * run + np.arange(250) * 1e-3, y, x, logged))
    names = ("run", "t_s", "v_sin_v", "v_cos_v", "angle_ref_rad")
    columns = dict(zip(names, map(np.concatenate, zip(*rows, strict=True)), strict=True))
    stated = {"v_sin_v": sigma, "v_cos_v": sigma, "angle_ref_rad": reference}
    if decoded:
        columns["angle_rad"] = np.mod(np.arctan2(columns.pop("v_sin_v"), columns.pop("v_cos_v")), TURN)
        stated = {"angle_rad": sigma, "angle_ref_rad": reference}
    return Log.from_arrays(columns, Noise.given(stated, tuple(columns)))


def fitted(log, **more):
    return hallsym.fit(log, "rotary", effects=OWN, solver="direct", **more)


def said_zeros(fit):
    (note,) = [n for n in fit.notes if n.startswith("Each run has a zero of its own")]
    return [float(part.split(":")[1]) for part in note.split(": ", 1)[1].split(". A delay")[0].split(", ")]


@pytest.mark.parametrize("decoded", [False, True], ids=["voltages", "angle"])
def test_each_run_has_its_zero_and_a_held_out_one_too(decoded):
    fit = fitted(recorded(decoded=decoded), holdout=(2,))
    if decoded:
        ratios = [TRUTH["Vx"] / TRUTH["Ax"], TRUTH["Vy"] / TRUTH["Ay"], TRUTH["Ay"] / TRUTH["Ax"]]
        assert [c.expression for c in fit.combinations] == ["Vx/Ax", "Vy/Ay", "Ay/Ax"]
        pulls = [(c.value - t) / c.std for c, t in zip(fit.combinations, ratios, strict=True)]
    else:
        pulls = [(fit.value(n) - v) / fit.std[fit.model.names.index(n)] for n, v in TRUTH.items()]
    assert np.abs(pulls).max() < 4
    expected = np.degrees(wrapped(np.array(HOMES) - HOMES[0], TURN))
    assert said_zeros(fit) == pytest.approx(
        expected, abs=0.01
    )  # 5 sigma of a zero from 250 samples: 0.006 deg
    rows = fit.errors.rows()
    assert rows["holdout"]["rmse"]["angle_rad"] < 1.1 * rows["fitted"]["rmse"]["angle_rad"]
    assert fit.value("zero") == 0.0


def test_homing_changes_nothing_but_the_zeros():
    homed, same = fitted(recorded()), fitted(recorded(homes=(0.6,) * 6))
    assert homed.values == pytest.approx(same.values, abs=1e-3 * 7e-6)  # of the least standard uncertainty
    assert homed.std[:5] == pytest.approx(same.std[:5], rel=1e-3)
    assert np.abs(said_zeros(same)).max() < 0.01


def test_over_whole_turns_it_costs_the_zero_alone_and_over_less_more():
    cost = []
    for turns in (3, 0.3):
        log = recorded(homes=(0.6,) * 12, turns=turns)
        plain = hallsym.fit(log, "rotary", solver="direct")
        ratio = fitted(log).std[:5] / plain.std[:5]
        assert ratio.min() > 0.999
        cost.append(ratio.max())
    assert cost[0] < 1.01
    assert cost[1] > 1.1


@pytest.mark.slow
def test_default_says_that_zeros_differ_or_claims_that_none_suits():
    first = hallsym.fit(recorded(), "rotary", solver="direct").claims[0]
    assert first.name == "homed"
    assert "--effect zero_deviation" in first.text
    near = hallsym.fit(recorded(homes=(0.6, 0.6, 0.7, 0.6)), "rotary", solver="direct")
    (note,) = [n for n in near.notes if "differs between runs" in n]
    assert "run 2" in note
    assert float(note.split(" by ")[1].split()[0]) == pytest.approx(
        np.degrees(0.1), abs=1.5
    )  # a mean, not a fit
    quiet = hallsym.fit(recorded(homes=(0.6,) * 4), "rotary", solver="direct")
    assert not any("differs between runs" in n for n in quiet.notes)
