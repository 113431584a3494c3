"""What to record next: choose runs from ranges so that parameters or positions become most certain.

`ranges` says what may be recorded, `candidates` and `curves` list the runs, `information` says what each
would tell, `criteria` what counts, `relaxed` bounds what any choice can reach, `exchange` chooses, `study`
and `design` put it together, `comparison` sets a plan beside another campaign.
"""

from hallsym.experiment.candidates import Candidate, candidates
from hallsym.experiment.comparison import Comparison
from hallsym.experiment.criteria import CRITERIA, Criterion, criterion
from hallsym.experiment.curves import closed_curves
from hallsym.experiment.design import Plan, plan
from hallsym.experiment.exchange import choose, exchange, greedy
from hallsym.experiment.information import Worst, planned_cost
from hallsym.experiment.ranges import Ranges, paper_ranges, read_ranges
from hallsym.experiment.relaxed import relax
from hallsym.experiment.study import Outcome

__all__ = [
    "CRITERIA",
    "Candidate",
    "Comparison",
    "Criterion",
    "Outcome",
    "Plan",
    "Ranges",
    "Worst",
    "candidates",
    "choose",
    "closed_curves",
    "criterion",
    "exchange",
    "greedy",
    "paper_ranges",
    "plan",
    "planned_cost",
    "read_ranges",
    "relax",
]
