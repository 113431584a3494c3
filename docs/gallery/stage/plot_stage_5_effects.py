"""
How much a parameter matters
============================

The error of position that one standard uncertainty, or 1 %, of each parameter makes, beside the
noise of one reading.
"""

import hallsym
from hallsym.report.drawing import draw
from hallsym.report.results.identifiability import effects

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
figure = draw(effects(hallsym.identify(fit)))
