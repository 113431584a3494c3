"""Curves for the machine to follow, given by points or expressions, with the error that their form makes.

After Diaz-Perez et al., Micromachines 2019, 10(9), 597, doi:10.3390/mi10090597: fg-Bernstein bases, whose
collocation matrices are solved with high relative accuracy. Beside them stand splines and polylines, and a
table says which is best for the curve at hand.

`factorisation`: the bases, TNBDA, TNSolve and TNQR. `curve`: what a curve is. `nominal`, `bounds`:
expressions, and errors that are bounded. `points`, `choose`: which method. `export`: tables and G-code.
"""

from hallsym.trajectory.bounds import bound
from hallsym.trajectory.choose import Candidate, Choice, choose_curve
from hallsym.trajectory.curve import Curve, is_curve, read_curve
from hallsym.trajectory.nominal import Nominal, nominal
from hallsym.trajectory.points import Points, read_points

__all__ = [
    "Candidate", "Choice", "Curve", "Nominal", "Points", "bound", "choose_curve", "is_curve", "nominal",
    "read_curve", "read_points",
]  # fmt: skip
