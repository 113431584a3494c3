"""What to record next: choose runs from ranges so that parameters or positions become most certain.

`ranges` says what may be recorded, `candidates` lists the runs, `study` says what each would tell, `criteria`
what counts and which runs are best, `design` puts it together.
"""

from hallsym.experiment.candidates import Candidate, candidates
from hallsym.experiment.criteria import CRITERIA, Criterion, choose, criterion
from hallsym.experiment.design import Plan, plan
from hallsym.experiment.ranges import Ranges, paper_ranges, read_ranges
from hallsym.experiment.study import Worst, planned_cost

__all__ = [
    "CRITERIA",
    "Candidate",
    "Criterion",
    "Plan",
    "Ranges",
    "Worst",
    "candidates",
    "choose",
    "criterion",
    "paper_ranges",
    "plan",
    "planned_cost",
    "read_ranges",
]
