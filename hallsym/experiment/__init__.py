"""What to record next: choose runs from ranges so that parameters or positions become most certain.

`ranges` says what may be recorded, `candidates` lists the runs, `information` says what each would tell,
`criteria` what counts, `relaxed` bounds what any choice can reach, `exchange` chooses, `study` and `design`
put it together, `compare` sets a plan beside another campaign.
"""

from hallsym.experiment.criteria import CRITERIA
from hallsym.experiment.design import Plan, plan
from hallsym.experiment.ranges import Ranges, paper_ranges, read_ranges

__all__ = ["CRITERIA", "Plan", "Ranges", "paper_ranges", "plan", "read_ranges"]
