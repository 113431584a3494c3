"""Optimisers that know nothing of sensors.

`Problem` says what to minimise; `minimize` searches a box with a population, `ipopt` and `newton` refine one
point, `hybrid` does both; each returns a `Result`. `gauss_newton` is the loop for costs that are expensive to
linearise. To add a global method write its equations as a generator
(see `solvers.problem.Solver`; `solvers/tlbo.py` has short examples) and name it in `solvers.driver.SOLVERS`.

Needs numpy and casadi, nothing else, and nothing of hallsym.
"""

from solvers.driver import SOLVERS, minimize, reflect
from solvers.gauss_newton import gauss_newton
from solvers.hybrid import EXPLORERS, hybrid
from solvers.ipopt import Ipopt, ipopt
from solvers.multistart import best_apart, latin_hypercube, screened_starts
from solvers.newton import bounded_step, newton
from solvers.problem import Population, Problem, Result

__all__ = [
    "EXPLORERS",
    "SOLVERS",
    "Ipopt",
    "Population",
    "Problem",
    "Result",
    "best_apart",
    "bounded_step",
    "gauss_newton",
    "hybrid",
    "ipopt",
    "latin_hypercube",
    "minimize",
    "newton",
    "reflect",
    "screened_starts",
]
