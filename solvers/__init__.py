"""Optimisers that know nothing of sensors.

`Problem` says what to minimise; `minimize` searches a box with a population, `ipopt` and `newton` refine one
point, `hybrid` does both; each returns a `Result`. `gauss_newton` is the loop for costs that are expensive to
linearise. To add a global method write its equations as a generator
(see `solvers.problem.Solver`; `solvers/pso.py` is the shortest example) and name it in
`solvers.driver.SOLVERS`.

Needs numpy and casadi, nothing else, and nothing of hallsym.
"""

from solvers.box import BOUNDS, reflect
from solvers.driver import SOLVERS, Stop, minimize
from solvers.gauss_newton import gauss_newton
from solvers.hybrid import EXPLORERS, REFINERS, HybridResult, hybrid
from solvers.ipopt import Ipopt, ipopt
from solvers.limits import discarding, ranking
from solvers.multistart import best_apart, latin_hypercube, screened_starts
from solvers.newton import newton
from solvers.problem import Population, Problem, Result
from solvers.quadratic import bounded_step

__all__ = [
    "BOUNDS",
    "EXPLORERS",
    "REFINERS",
    "SOLVERS",
    "HybridResult",
    "Ipopt",
    "Population",
    "Problem",
    "Result",
    "Stop",
    "best_apart",
    "bounded_step",
    "discarding",
    "gauss_newton",
    "hybrid",
    "ipopt",
    "latin_hypercube",
    "minimize",
    "newton",
    "ranking",
    "reflect",
    "screened_starts",
]
