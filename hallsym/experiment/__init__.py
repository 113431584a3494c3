"""Optimal experiments: choose runs from ranges that minimise the uncertainty of parameters or positions.

`ranges` states the admissible recordings and lists the runs, `study` computes the information of each,
`criteria` ranks choices, `design` returns the plan.
"""

from hallsym.experiment.criteria import CRITERIA
from hallsym.experiment.design import Plan, plan
from hallsym.experiment.ranges import Ranges, paper_ranges, read_ranges
from hallsym.experiment.study import Worst

__all__ = ["CRITERIA", "Plan", "Ranges", "Worst", "paper_ranges", "plan", "read_ranges"]
