"""
Which parameters are traded
===========================

Correlation of the estimates. Two parameters near +1 or -1 can change together without changing the
readings.
"""

import hallsym
from hallsym.report.drawing import draw
from hallsym.report.results.identifiability import correlation

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
figure = draw(correlation(hallsym.identify(fit)))
