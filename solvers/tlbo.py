"""Teaching-learning-based optimisation (TLBO) and its Gaussian bare-bones form (GBTLBO).

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

from solvers.problem import Evaluate, FloatArray, Population

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
