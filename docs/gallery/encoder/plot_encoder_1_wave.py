"""
An encoder over one turn
========================

The arctangent of the two voltages is off by up to a degree: offsets make one wave per turn, unequal
amplitudes and a phase other than 90 degrees make two. The fitted ellipse takes both out.
"""

import matplotlib.pyplot as plt
import numpy as np

import hallsym

log = hallsym.read_log("../../../data/encoder")
fit = hallsym.fit(log, "rotary", solver="direct")
decode = hallsym.decouple(fit)


def error_deg(angle):
    """The difference from the reference, without the common zero, in degrees."""
    off = np.exp(1j * (angle - reference))
    return np.degrees(np.angle(off / off.mean()))


run = log.run(log.runs[0])
reference = run["angle_ref_rad"]
plain = np.arctan2(run["v_sin_v"], run["v_cos_v"])
fitted = np.asarray(
    decode(np.vstack([run["v_sin_v"], run["v_cos_v"]]), np.zeros((0, len(reference))))
).ravel()

figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
turn = np.degrees(np.mod(reference, 2 * np.pi))
ax.plot(turn, error_deg(plain), ".", ms=3, color="0.7", label="arctangent of the voltages")
ax.plot(turn, error_deg(fitted), ".", ms=3, color="0.1", label="with the fitted ellipse")
ax.set(xlabel="angle [deg]", ylabel="error [deg]", xticks=range(0, 361, 60))
ax.legend()
