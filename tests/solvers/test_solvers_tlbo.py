"""TLBO, GBTLBO, SHTLBO: every equation by itself, with random numbers that are known, then the statistics."""

import numpy as np
import pytest

from solvers import Population, Problem, minimize
from solvers.tlbo import (
    decline,
    learn,
    learn_around,
    learn_bare,
    shtlbo,
    tally,
    teach,
    teach_around,
    teach_bare,
    updated,
)


class Dealt:
    """A generator that deals prepared numbers and fails when asked for something else."""

    def __init__(self, **dealt):
        self.dealt = {kind: iter(values) for kind, values in dealt.items()}

    def _next(self, kind, shape):
        value = np.asarray(next(self.dealt[kind]))
        assert value.shape == (shape if isinstance(shape, tuple) else (shape,))
        return value

    def random(self, shape):
        return self._next("uniform", shape)

    def standard_normal(self, shape):
        return self._next("normal", shape)

    def integers(self, low, high, n):
        assert (low, high) == (0, n - 1)
        return self._next("integer", (n,))


# Three students in two dimensions; the second is the teacher, the mean is (2, 1).
CLASS = Population(np.array([[0.0, 3.0], [2.0, 0.0], [4.0, 0.0]]), np.array([5.0, 1.0, 3.0]))
R = np.array([[0.5, 1.0], [0.25, 0.0], [1.0, 0.5]])
N = np.array([[1.0, -1.0], [2.0, 0.5], [-0.5, 3.0]])
K = np.array([0, 1, 0])  # becomes 1, 2, 0: the number of the own row is skipped


def test_16_and_17_teacher_phase():
    """r (T - TF Mean), TF = round(1 + rand): .2 -> 1, .7 -> 2, 0 -> 1."""
    new = teach(CLASS, Dealt(uniform=[R, [[0.2], [0.7], [0.0]]]))
    assert new.tolist() == [[0.0, 2.0], [2.0 - 0.25 * 2.0, 0.0], [4.0, -0.5]]


def test_18_learner_phase():
    """Student 0 goes towards 1 (better), 1 away from 2 (worse), 2 away from 0 (worse)."""
    new = learn(CLASS, Dealt(integer=[K], uniform=[R]))
    assert new.tolist() == [
        [0.0 + 0.5 * 2.0, 3.0 - 3.0],
        [2.0 - 0.25 * 2.0, 0.0],
        [4.0 + 4.0, 0.0 - 0.5 * 3.0],
    ]


def test_19_bare_teacher_phase():
    new = teach_bare(CLASS, Dealt(normal=[N]))
    assert new.tolist() == [[1.0 + 2.0, 1.5 - 3.0], [2.0, 0.0], [3.0 - 0.5 * 2.0, 0.0]]


def test_20_bare_learner_phase():
    new = learn_bare(CLASS, Dealt(integer=[K], normal=[N]))
    assert new.tolist() == [
        [1.0 + 2.0, 1.5 - 3.0],
        [3.0 + 2.0 * 2.0, 0.0],
        [2.0 - 0.5 * 4.0, 1.5 + 3.0 * 3.0],
    ]


def test_21_and_22_stay_centred_on_the_student():
    new = teach_around(CLASS, Dealt(normal=[N]))
    assert new.tolist() == [[0.0 + 2.0, 3.0 - 3.0], [2.0, 0.0], [4.0 - 0.5 * 2.0, 0.0]]
    new = learn_around(CLASS, Dealt(integer=[K], normal=[N]))
    assert new.tolist() == [[2.0, 0.0], [2.0 + 2.0 * 2.0, 0.0], [4.0 - 0.5 * 4.0, 0.0 + 3.0 * 3.0]]


def test_23_and_24_choose_a_move_per_student():
    """One generation by hand: first uniform number < p takes the TLBO move, the others the Gaussian one."""
    tried = []

    def evaluate(x):
        tried.append(x)
        return Population(x, np.full(len(x), 9.0))  # nothing is better: the class stays as it is

    factor = [[0.2], [0.7], [0.0]]
    dealt = Dealt(
        uniform=[[0.49, 0.5, 0.9], R, factor, [0.5, 0.1, 0.2], R],
        normal=[N, N],
        integer=[K, K],
    )
    after = next(shtlbo(CLASS, evaluate, dealt))
    teacher, around = teach(CLASS, Dealt(uniform=[R, factor])), teach_around(CLASS, Dealt(normal=[N]))
    assert tried[0].tolist() == [teacher[0].tolist(), around[1].tolist(), around[2].tolist()]
    partner = learn(CLASS, Dealt(integer=[K], uniform=[R]))
    around = learn_around(CLASS, Dealt(integer=[K], normal=[N]))
    assert tried[1].tolist() == [around[0].tolist(), partner[1].tolist(), partner[2].tolist()]
    assert np.array_equal(after.x, CLASS.x)


class Chooser:
    """Prepared numbers where a move is chosen, zero normal numbers (so the Gaussian moves stand still)."""

    def __init__(self, *choices):
        self.choices, self.rng = iter(choices), np.random.default_rng(0)
        self.integers = self.rng.integers

    def random(self, shape):
        return self.rng.random(shape) if isinstance(shape, tuple) else np.full(shape, next(self.choices))

    def standard_normal(self, shape):
        return np.zeros(shape)


def test_p_follows_what_paid_off_within_its_limits_and_forgets():
    """Generation 1: only the first move improves, p = .95. Generation 2: only the second, p = .05, where
    counters that are not reset would give .5. Numbers just below and above p show which move was taken."""
    improving = iter([True, False, False, True, False, False])  # two phases in each of three generations
    students, took_first = CLASS, []

    def evaluate(x):
        nonlocal students
        took_first.append(not np.array_equal(x, students.x))
        if not next(improving):
            return Population(x, np.full(3, np.inf))
        students = Population(x, students.cost / 2.0)
        return students

    generations = shtlbo(CLASS, evaluate, Chooser(0.49, 0.51, 0.94, 0.96, 0.04, 0.06))
    for _ in range(3):
        assert next(generations).x.tolist() == students.x.tolist()
    assert took_first == [True, False] * 3


def test_27_28_29_decline_rule():
    """Declines .5 and .25 in 3 trials of the first, .1 in 2 of the second: .75 x 2 / (.1 x 3 + .75 x 2)."""
    old, new = np.array([4.0, 4.0, 4.0, 10.0, 10.0]), np.array([2.0, 3.0, 5.0, 9.0, 10.0])
    assert decline(old, new).tolist() == [0.5, 0.25, 0.0, 0.1, 0.0]
    credit = tally(np.arange(5) < 3, decline(old, new))
    assert updated(0.5, credit) == pytest.approx(1.5 / 1.8, rel=1e-15)


def test_tlbo_is_drawn_to_the_origin_and_the_gaussian_form_is_not():
    """(16) is not invariant to a move of the origin: an optimum away from it is much harder."""

    def decades(solver, at):
        problem = Problem(lambda x: ((x - at) ** 2).sum(axis=1), [at - 5.0] * 5, [at + 5.0] * 5)
        return np.log10([minimize(problem, solver, seed=s, size=20, budget=1220).cost for s in range(15)])

    assert decades("tlbo", 3.0).mean() - decades("tlbo", 0.0).mean() > 2.0
    assert decades("gbtlbo", 3.0) == pytest.approx(decades("gbtlbo", 0.0), abs=1e-6)
