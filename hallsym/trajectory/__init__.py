"""Curves for the machine to follow, given by points or expressions, with the error that their form makes.

After Diaz-Perez et al., Micromachines 2019, 10(9), 597, doi:10.3390/mi10090597: fg-Bernstein bases, whose
collocation matrices are solved with high relative accuracy. Beside them stand Chebyshev nodes, splines, least
squares and rational functions, and a table says which is best for the curve at hand.

`basis`, `factorisation`, `orthogonal`: the bases, TNBDA and TNSolve, TNQR. `corner_cutting`, `forms`,
`curve`: what a curve is. `nominal`, `intervals`, `jets`, `bounds`: expressions, and errors that are bounded.
`methods`, `candidate`, `choose`, `leave_one_out`, `notes`, `verb`: which method. `polynomials`, `export`,
`c_code`: files. `position_error`: Eq. (15).
"""

from hallsym.trajectory.basis import BERNSTEIN, Basis, trigonometric
from hallsym.trajectory.bounds import Bound, bound
from hallsym.trajectory.candidate import Candidate, Choice
from hallsym.trajectory.choose import of_nominal
from hallsym.trajectory.curve import Curve, is_curve, read_curve
from hallsym.trajectory.factorisation import Factors, factorise
from hallsym.trajectory.leave_one_out import of_points
from hallsym.trajectory.methods import METHODS, NODES, Method
from hallsym.trajectory.nominal import Nominal, nominal
from hallsym.trajectory.orthogonal import Orthogonal, orthogonalise
from hallsym.trajectory.points import Points, points_of, read_points
from hallsym.trajectory.position_error import CurveCost, curve_cost
from hallsym.trajectory.verb import choose_curve

__all__ = [
    "BERNSTEIN",
    "METHODS",
    "NODES",
    "Basis",
    "Bound",
    "Candidate",
    "Choice",
    "Curve",
    "CurveCost",
    "Factors",
    "Method",
    "Nominal",
    "Orthogonal",
    "Points",
    "bound",
    "choose_curve",
    "curve_cost",
    "factorise",
    "is_curve",
    "nominal",
    "of_nominal",
    "of_points",
    "orthogonalise",
    "points_of",
    "read_curve",
    "read_points",
    "trigonometric",
]
