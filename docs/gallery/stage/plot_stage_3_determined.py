"""
What the data determine
=======================

Each parameter's interval relative to its size. The colour says whether the recording determines it
well, poorly or not at all.
"""

import hallsym
from hallsym.report.figures import intervals

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
figure = intervals(hallsym.identify(fit))
