"""
The ellipse of an encoder
=========================

The two voltages against each other. Centre, axes and tilt of the ellipse are what the fit finds; a
perfect encoder draws the dashed circle.
"""

import matplotlib.pyplot as plt
import numpy as np

import hallsym

log = hallsym.read_log("../../../data/encoder")
fit = hallsym.fit(log, "rotary", solver="direct")
run = log.run(log.runs[0])

figure, ax = plt.subplots(figsize=(4.2, 4.2), layout="constrained")
t = np.linspace(0, 2 * np.pi, 400)
ax.plot(np.cos(t), np.sin(t), "--", color="0.5", lw=1, label="perfect")
ax.plot(run["v_cos_v"], run["v_sin_v"], ".", ms=3, color="0.2", label="readings of one run")
ax.plot(fit.value("Vx"), fit.value("Vy"), "+", ms=12, color="C1", label="fitted centre")
ax.set(xlabel="v_cos [V]", ylabel="v_sin [V]", aspect="equal", xlim=(-1.25, 1.25), ylim=(-1.25, 1.25))
ax.legend(loc="center")
