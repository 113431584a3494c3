"""Curves for the machine to follow, given by points or expressions, with the error that their form makes.

After Diaz-Perez et al., Micromachines 2019, 10(9), 597, doi:10.3390/mi10090597: fg-Bernstein bases, whose
collocation matrices are solved with high relative accuracy. Beside them stand splines and polylines, and a
table says which is best for the curve at hand.

`factorisation`: the bases, TNBDA, TNSolve and TNQR. `curve`: what a curve is. `nominal`, `bounds`:
expressions, and errors that are bounded. `points`, `choose`: which method. `export`: tables and G-code.
"""

from hallsym.trajectory.bounds import Bound, bound
from hallsym.trajectory.choose import METHODS, Candidate, Choice, Method, choose_curve
from hallsym.trajectory.curve import Curve, is_curve, read_curve
from hallsym.trajectory.factorisation import BERNSTEIN, TRIGONOMETRIC, factorise, orthogonalise
from hallsym.trajectory.nominal import Nominal, nominal
from hallsym.trajectory.points import Points, points_of, read_points

__all__ = [
    "BERNSTEIN",
    "METHODS",
    "TRIGONOMETRIC",
    "Bound",
    "Candidate",
    "Choice",
    "Curve",
    "Method",
    "Nominal",
    "Points",
    "bound",
    "choose_curve",
    "factorise",
    "is_curve",
    "nominal",
    "orthogonalise",
    "points_of",
    "read_curve",
    "read_points",
]
