"""
What a sensor under a magnet array reads
========================================

The first harmonic decays with the gap by a factor of e every 4.8 mm at a wavelength of 30 mm, the
fifth five times as fast: near the array it bends the wave, far from it none is left.
"""

import matplotlib.pyplot as plt
import numpy as np

import hallsym
from hallsym.model import on_arrays

model = hallsym.build("halbach")
x = np.linspace(0, 0.03, 400)
figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
for gap, look in ((3e-3, "-"), (5e-3, "--"), (8e-3, ":")):
    pose = [x, np.full_like(x, gap)]
    (reading,) = on_arrays(model.reading)(model.nominal, np.zeros((0, len(x))), pose, [])
    ax.plot(1e3 * x, 1e3 * reading[0], look, color="0.1", label=f"gap {1e3 * gap:.0f} mm")
ax.set(xlabel="x [mm]", ylabel="first sensor [mV]")
ax.legend()
