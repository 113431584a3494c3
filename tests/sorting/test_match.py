"""`match_sensors`: the model's own error form, sets against trying all, what is predicted happens."""

from itertools import combinations, permutations

import numpy as np
import pytest

import hallsym
from hallsym.errors import InputError
from hallsym.sorting import match_sensors, sort_sensors
from hallsym.sorting.influence import influence_of_gains, is_symmetric, without_common
from hallsym.uncertainty.tolerances import Workspace
from tests.sorting.benches import bench
from tests.trial_families import LC, array_2dof

MODELS = (array_2dof(), hallsym.build("halbach_planar"), hallsym.build("stage31"), hallsym.build("rotary"))


def inventory(n, seed=0, spread=0.02):
    gains = 1 + np.random.default_rng(seed).normal(0, spread, n)
    return {f"s{k}": float(g) for k, g in enumerate(gains)}


# -- the error form ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_the_form_is_the_decoders_own_error(model):
    """Small gain errors, decoded by the nominal model, give the error that the Jacobian predicts."""
    usual = influence_of_gains(model).where
    influence = influence_of_gains(
        model, where=Workspace(0.45 * usual.pose, usual.state)
    )  # off the cut of atan2
    d = np.random.default_rng(0).normal(0, 1e-6, len(model.channels))
    decoded = influence.decoded_errors(1 + d[None])[:, 0]
    predicted = influence.error @ d
    assert np.abs(decoded - predicted).max() < 1e-4 * np.abs(predicted).max()
    assert np.mean(np.sum((predicted * influence.weights[:, None]) ** 2, axis=0)) == pytest.approx(
        d @ influence.square @ d
    )


@pytest.mark.parametrize("model", [m for m in MODELS if m.name != "halbach_planar"], ids=lambda m: m.name)
def test_what_a_gain_multiplies_is_what_its_parameters_do(model):
    """A machine whose gain parameters of a channel are 1 % larger reads what the influence says."""
    names = {"array_2dof": ("g1",), "rotary": ("Ax",)}.get(model.name, ("eta_B", "a_B", "b_B", "c_B"))
    influence = influence_of_gains(model)
    machine = influence.values.copy()
    for name in names:
        machine[model.names.index(name)] *= 1.01
    read = model.readings(machine, influence.where.pose, influence.where.state)
    np.testing.assert_allclose(
        read[1] - influence.reading[1], 0.01 * influence.part[1], atol=1e-12 * np.abs(read).max()
    )


def test_three_sums_a_third_of_a_period_apart_count_alike():
    """x = lc / 3 sum d sin 2(t - u), z = lc / 3 sum d (1 + cos 2(t - u)): only their variance counts."""
    influence = influence_of_gains(MODELS[0])
    plain, weights = without_common(influence.square)
    assert is_symmetric(plain)
    np.testing.assert_allclose(weights, 1 / 3)
    np.testing.assert_allclose(plain, LC**2 / 9 * (np.eye(3) - 1 / 3) * 1.5, rtol=1e-9, atol=1e-12)


def test_the_common_gain_is_the_best_one():
    square = influence_of_gains(MODELS[1]).square
    d = np.random.default_rng(1).normal(0, 0.01, len(square))
    plain, weights = without_common(square)
    least = min((d - c) @ square @ (d - c) for c in d @ weights + np.linspace(-1e-3, 1e-3, 2001))
    assert d @ plain @ d == pytest.approx(least, rel=1e-6)


# -- sets --------------------------------------------------------------------------------------------------


def all_sets(n, size):
    """Every way to split n sensors into sets of a size."""
    if n == ():
        yield []
        return
    for others in combinations(n[1:], size - 1):
        for more in all_sets(tuple(k for k in n[1:] if k not in others), size):
            yield [(n[0], *others), *more]


@pytest.mark.parametrize("seed", range(4))
def test_sets_are_those_of_trying_all(seed):
    """All 280 ways to split nine sensors into sets of three."""
    gains = inventory(9, seed)
    found = match_sensors(gains, MODELS[0])
    plain, _ = without_common(found.influence.square)
    g = np.array(list(gains.values()))
    g = g / np.median(g) - 1

    def total(sets):
        d = g[np.array(sets)]
        return float(np.einsum("mi,ij,mj->", d, plain, d))

    every = list(all_sets(tuple(range(9)), 3))
    assert len(every) == 280
    best = min(map(total, every))
    assert total(found.matched.sets) <= best * (1 + 1e-9) + 1e-18


def test_left_over_sensors_are_the_ones_that_cost_most():
    gains = inventory(30) | {"far": 1.4, "low": 0.7}
    found = match_sensors(gains, MODELS[0], sets=10)
    assert found.summary().startswith("10 matched sets of ")
    used = {found.sensors[k] for k in found.matched.sets.ravel()}
    assert not {"far", "low"} & used
    assert found.optimal


def test_the_order_within_a_set_is_the_best_one():
    found = match_sensors(inventory(30), MODELS[2])
    plain, _ = without_common(found.influence.square)
    g = np.array(list(inventory(30).values()))
    d = g[found.matched.sets] / np.median(g) - 1
    costs = [np.einsum("mi,ij,mj->m", d[:, o], plain, d[:, o]) for o in map(list, permutations(range(3)))]
    np.testing.assert_allclose(costs[0], np.min(costs, axis=0), rtol=1e-9)


def test_summed_sensors_are_dealt_so_that_high_and_low_gains_meet():
    gains = inventory(240, spread=0.03)
    found = match_sensors(gains, MODELS[0], members=2)
    assert found.matched.overall < 0.7 * match_sensors(gains, MODELS[0]).matched.overall
    assert found.places[:3] == ("col_0_v#1", "col_0_v#2", "col_1_v#1")
    assert len(set(found.matched.sets.ravel().tolist())) == 240


@pytest.mark.parametrize("model", MODELS, ids=lambda m: m.name)
def test_matched_sets_beat_bins_alone_for_every_model(model):
    found = match_sensors(inventory(600), model, sets=20)
    assert len(found.matched.sets) == 20
    assert found.matched.overall < found.bins.overall < found.ways[2].overall
    assert found.gain_over_bins > 1.2
    assert sorted(np.unique(found.matched.sets)) == sorted(found.matched.sets.ravel())


def test_the_error_to_expect_is_the_error_of_the_true_gains():
    """Sets are chosen by measured gains and decoded with the true ones."""
    expected, seen, bins = [], [], []
    for seed in range(4):
        table, gains = bench(n=600, seed=seed, repeats=300)
        found = match_sensors(sort_sensors(table), MODELS[0])
        true = np.array([gains[name] for name in found.sensors])
        plain, _ = without_common(found.influence.square)
        for way, into in ((found.matched, seen), (found.bins, bins)):
            d = true[way.sets] / true[way.sets].mean(axis=1, keepdims=True) - 1
            into.append(np.sqrt(np.einsum("mi,ij,mj->m", d, plain, d).mean()))
        expected.append((found.expected(found.matched), found.expected(found.bins)))
    mean = np.mean(expected, axis=0)
    assert np.mean(seen) == pytest.approx(mean[0], rel=0.1)
    assert np.mean(bins) == pytest.approx(mean[1], rel=0.15)


def test_other_values_and_another_workspace_count():
    model = MODELS[0]
    usual = influence_of_gains(model)
    doubled = influence_of_gains(model, {"g0": 2.0, "g1": 2.0, "g2": 2.0})
    np.testing.assert_allclose(doubled.square, usual.square)  # errors of gains are relative
    low = hallsym.build("stage31")
    campaign = hallsym.paper_campaign(0.05, 1.0)
    assert not np.allclose(
        influence_of_gains(low, {"H1x": 0.5}, campaign).square,
        influence_of_gains(low, None, campaign).square,
    )


# -- bad input ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gains", "model", "options", "words"),
    [
        (inventory(2), MODELS[0], {}, "2 were sorted"),
        (inventory(30), MODELS[0], {"sets": 11}, "need 33 sensors"),
        (inventory(30), MODELS[0], {"members": 0}, "1 or more sensors"),
        (inventory(30) | {"bad": -1.0}, MODELS[0], {}, "sensor bad"),
    ],
)  # fmt: skip
def test_bad_input_is_one_sentence(gains, model, options, words):
    with pytest.raises(InputError) as error:
        match_sensors(gains, model, **options)
    assert words in str(error.value)
