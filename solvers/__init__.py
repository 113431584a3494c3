"""Optimisers that know nothing of sensors.

`Problem` says what to minimise; `minimize` searches a box with a population, `ipopt` and `newton` refine one
point, `hybrid` does both; each returns a `Result`. `gauss_newton` is the loop for costs that are expensive to
linearise, `bounded_step` the step inside a box. To add a global method write its equations as a generator
(see `solvers.problem.Solver`; `solvers/tlbo.py` has short examples) and name it in `solvers.driver.SOLVERS`.

Needs numpy and casadi, nothing else, and nothing of hallsym.
"""

from solvers.driver import EXPLORERS, SOLVERS, hybrid, minimize, screened_starts
from solvers.ipopt import ipopt
from solvers.newton import bounded_step, gauss_newton, newton
from solvers.problem import Population, Problem, Result

__all__ = [
    "EXPLORERS", "SOLVERS", "Population", "Problem", "Result", "bounded_step", "gauss_newton", "hybrid",
    "ipopt", "minimize", "newton", "screened_starts",
]  # fmt: skip
