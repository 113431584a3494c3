"""
What a calibration gains
========================

A fit of Model (31) to the bundled campaign of 57 runs: errors of the decoded position at each of
the 19 vertical settings, with the design's parameters and with the fitted ones. The dashed line is
what the stated noise leaves.
"""

import hallsym

log = hallsym.bundled_campaign()
fit = hallsym.fit(log, "stage31", solver="direct")
figure = fit.plot()
