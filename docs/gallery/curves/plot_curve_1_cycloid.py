"""
A curve within 50 nm
====================

Distance from the nominal cycloid, 6.3 mm long, of the best curve of several methods.
"""

import matplotlib.pyplot as plt
import numpy as np

import hallsym

choice = hallsym.choose_curve(
    "x = r*(t - sin(t)); y = r*(1 - cos(t))", 5e-8, span="t=0:2*pi", values={"r": 1e-3}
)
t = np.linspace(0, 2 * np.pi, 2001)
cycloid = 1e-3 * np.column_stack([t - np.sin(t), 1 - np.cos(t)])

figure, ax = plt.subplots(figsize=(7, 3), layout="constrained")
met = sorted((c for c in choice.candidates if choice.meets(c)), key=lambda c: c.curve.control_points)[:3]
for candidate, look in zip(met, ("-", "--", ":"), strict=True):
    off = np.linalg.norm(np.asarray(candidate.curve(t))[:, :2] - cycloid, axis=1)
    label = f"{candidate.method.words}: {candidate.curve.control_points} control points"
    ax.semilogy(t, 1e9 * np.maximum(off, 1e-13), look, color="0.1", label=label)
ax.axhline(50, color="C1", lw=1, label="tolerance")
ax.set(xlabel="t", ylabel="distance [nm]", ylim=(1e-3, 1e5))
ax.legend(loc="upper center", ncols=2)
