"""
What to record next
===================

The settings of a campaign that determines the parameters as well as Table 6 of the paper does, in
fewer runs.
"""

from dataclasses import replace

import hallsym
from hallsym.report.drawing import draw
from hallsym.report.results.plan import coverage

noise = hallsym.table8_noise(hallsym.build("stage31")).sigma
ranges = replace(hallsym.paper_ranges(), minutes=None, noise=noise)
truth = hallsym.published.values("table7_estimates")
table6 = hallsym.paper_campaign(ranges.step_s, ranges.seconds_per_run)
plan = hallsym.plan(ranges, "stage31", truth, runs=20)
figure = draw(coverage(plan, table6, "Table 6"))
