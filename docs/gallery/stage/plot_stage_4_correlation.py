"""
Which parameters are traded
===========================

Correlation of the estimates. Two parameters near +1 or -1 can change together without changing the
readings.
"""

import hallsym

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
figure = hallsym.identify(fit).plot()
