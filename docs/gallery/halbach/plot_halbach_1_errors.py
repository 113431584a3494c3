"""
Errors of a magnet array by their period
========================================

A gain off by 1 % at one sensor and an offset of 5 mV each leave an error of their own period: half
a wavelength and a whole one.
"""

import hallsym

model = hallsym.build("halbach", added=("gain_mismatch", "offset_error"))
figure = hallsym.error_model(model, {"gain_0": 0.01, "offset_error_0": 5e-3}).plot()
