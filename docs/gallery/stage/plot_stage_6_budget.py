"""
A budget of one position
========================

Which source makes the uncertainty of the decoded position: noise, the steps of the converter, the
calibration itself.
"""

import hallsym
from hallsym.report.drawing import draw
from hallsym.report.results.budget import budget_bars
from hallsym.uncertainty import Settings, position_budget

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
settings = Settings(averaged=4, zero_averaged=500, adc_step=60e-9)
figure = draw(budget_bars(position_budget(fit, {"x_m": 2e-4, "z_m": 2e-4}, settings)))
