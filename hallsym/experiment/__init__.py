"""What to record next: choose runs from ranges so that parameters or positions become most certain.

`ranges` says what may be recorded and lists the runs, `study` says what each would tell, `criteria` what
counts and which runs are best, `design` puts it together.
"""

from hallsym.experiment.criteria import CRITERIA
from hallsym.experiment.design import Plan, plan
from hallsym.experiment.ranges import Ranges, paper_ranges, read_ranges
from hallsym.experiment.study import Worst

__all__ = ["CRITERIA", "Plan", "Ranges", "Worst", "paper_ranges", "plan", "read_ranges"]
