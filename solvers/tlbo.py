"""Teaching-learning-based optimisation: TLBO, its Gaussian bare-bones form (GBTLBO) and SHTLBO.

Equation numbers are those of Chen et al., Sensors 2016, 16, 872, doi:10.3390/s16060872, which cites
TLBO from Rao, Savsani & Vakharia, Computer-Aided Design 43 (2011) 303, doi:10.1016/j.cad.2010.12.015, and
GBTLBO from Ghasemi et al., 2015.

A student is a row `St` of the class, the teacher `T` its best row. Each phase moves the whole class at
once: teacher, mean and partners are those at the start of the phase, and a student moves only if that is
strictly better. Where the paper is silent: random numbers are drawn per student and per dimension, the
teaching factor per student, and no student is its own partner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from solvers.problem import BoolArray, Evaluate, FloatArray, Population

Move = Callable[[Population, np.random.Generator], FloatArray]


def teach(students: Population, rng: np.random.Generator) -> FloatArray:
    """Every student follows the teacher away from the mean."""
    r = rng.random(students.x.shape)
    factor = np.rint(1.0 + rng.random((len(students), 1)))  # (17): 1 or 2
    return students.x + r * (students.best - factor * students.x.mean(axis=0))  # (16)


def learn(students: Population, rng: np.random.Generator) -> FloatArray:
    """Every student moves towards a better partner, or away from one that is not better."""
    k = partners(len(students), rng)
    towards = np.where(students.cost[k] < students.cost, 1.0, -1.0)[:, None]
    return students.x + towards * rng.random(students.x.shape) * (students.x[k] - students.x)  # (18)


def teach_bare(students: Population, rng: np.random.Generator) -> FloatArray:
    """Gaussian half-way between student and teacher."""
    middle, distance = (students.x + students.best) / 2.0, np.abs(students.best - students.x)
    return middle + rng.standard_normal(students.x.shape) * distance  # (19)


def learn_bare(students: Population, rng: np.random.Generator) -> FloatArray:
    """Gaussian half-way between student and partner."""
    other = students.x[partners(len(students), rng)]
    middle, distance = (students.x + other) / 2.0, np.abs(students.x - other)
    return middle + rng.standard_normal(students.x.shape) * distance  # (20)


def partners(n: int, rng: np.random.Generator) -> np.ndarray:
    """For each of `n` students the number of another one."""
    k = rng.integers(0, n - 1, n)
    return k + (k >= np.arange(n))  # k != j


def _generations(
    population: Population, evaluate: Evaluate, rng: np.random.Generator, phases: tuple[Move, Move]
) -> Iterator[Population]:
    while True:
        for move in phases:
            population = population.improved_by(evaluate(move(population, rng)))
        yield population


def tlbo(population: Population, evaluate: Evaluate, rng: np.random.Generator) -> Iterator[Population]:
    """TLBO: teacher phase (16), learner phase (18); nothing to tune."""
    return _generations(population, evaluate, rng, (teach, learn))


def gbtlbo(population: Population, evaluate: Evaluate, rng: np.random.Generator) -> Iterator[Population]:
    """GBTLBO: Gaussian teacher phase (19) and learner phase (20); nothing to tune."""
    return _generations(population, evaluate, rng, (teach_bare, learn_bare))


# -- self-adaptive hybrid TLBO -----------------------------------------------------------------------------

# Each student takes the TLBO move with probability p, else a Gaussian one around itself, in both phases; p
# follows which of the two has paid off, by relative declines of the cost, (27) to (29). Where the paper is
# silent: p is updated once per generation from both phases together, then the counters start again; it stays
# within [.05, .95], so that neither move dies out; when the rule says 0/0 (nothing improved, or one move was
# never tried) p stays as it is.

START, LOW, HIGH = 0.5, 0.05, 0.95


def teach_around(students: Population, rng: np.random.Generator) -> FloatArray:
    """Gaussian around the student, as wide as its distance from the teacher."""
    return students.x + rng.standard_normal(students.x.shape) * np.abs(students.best - students.x)  # (21)


def learn_around(students: Population, rng: np.random.Generator) -> FloatArray:
    """Gaussian around the student, as wide as its distance from a partner."""
    other = students.x[partners(len(students), rng)]
    return students.x + rng.standard_normal(students.x.shape) * np.abs(students.x - other)  # (22)


def decline(old: FloatArray, new: FloatArray) -> FloatArray:
    """Relative decline (29) of those that improved, else 0; shape (n,).

    The paper divides by `f_old`, and so does this while costs are positive. A cost that reaches or crosses
    zero would divide by nothing, so the larger of the two magnitudes is taken: never more than 2 then.
    From an infinite cost to a finite one is a decline of 1.
    """
    gained = np.where(np.isinf(old), 1.0, 0.0) * (new < old)
    usual = (new < old) & np.isfinite(old)
    old, new = old[usual], new[usual]
    gained[usual] = (old - new) / np.maximum(np.abs(old), np.abs(new))
    return gained


def tally(first: BoolArray, gained: FloatArray) -> FloatArray:
    """`[[v1, n1], [v2, n2]]`: what each move gained (28), and how often it was tried, n = ns + nf."""
    return np.array([[gained[own].sum(), np.count_nonzero(own)] for own in (first, ~first)])


def updated(p: float, credit: FloatArray) -> float:
    """The new p (27) from a tally."""
    (v1, n1), (v2, n2) = credit
    below = v2 * n1 + v1 * n2
    return float(v1 * n2 / below) if below > 0.0 else p


def shtlbo(population: Population, evaluate: Evaluate, rng: np.random.Generator) -> Iterator[Population]:
    """SHTLBO: hybrid teacher phase (23), hybrid learner phase (24), p by (27)."""
    p = START
    while True:
        credit = np.zeros((2, 2))
        for move, gaussian in ((teach, teach_around), (learn, learn_around)):
            first = rng.random(len(population)) < p
            tried = evaluate(
                np.where(first[:, None], move(population, rng), gaussian(population, rng))  # (23), (24)
            )
            credit += tally(first, decline(population.cost, tried.cost))
            population = population.improved_by(tried)
        p = min(max(updated(p, credit), LOW), HIGH)
        yield population
