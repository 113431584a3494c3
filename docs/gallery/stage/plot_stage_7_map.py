"""
Where the position is least certain
===================================

The expanded uncertainty over the workspace.
"""

import hallsym
from hallsym.uncertainty import Settings

fit = hallsym.fit(hallsym.bundled_campaign(), "stage31", solver="direct")
ranges = {"x_m": (-3e-4, 3e-4), "y_m": (-5e-4, 5e-4), "z_m": (-2.5e-4, 2.5e-4)}
figure = hallsym.uncertainty_map(fit, ranges, Settings(averaged=4)).plot()
