"""
Parameters and their uncertainties
==================================

Estimates against the design's values, each with its 95 % interval. Parameters that no recording
determines are listed with the combination that is.
"""

import hallsym
from hallsym.report.figures.campaign import parameters

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
figure = parameters(fit)
