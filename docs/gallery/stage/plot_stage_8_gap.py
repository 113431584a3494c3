"""
A gap and its cause
===================

A model without the vertical coupling leaves 9 um of error on runs that took no part in the fit. The
diagnosis names the coupling; with it the error falls to the noise.
"""

import matplotlib.pyplot as plt

import hallsym

found = hallsym.diagnose(hallsym.bundled_campaign(), "stage30")
print(found.verdict, found.ranked)

figure, axes = plt.subplots(1, 2, figsize=(7, 3), layout="constrained")
gaps = ((found.gap_before, "model without coupling", "0.75"), (found.gap_after, "with it", "0.25"))
for ax, columns, unit in ((axes[0], ("x_m", "y_m"), "um"), (axes[1], ("rz_rad",), "urad")):
    for k, (gap, label, color) in enumerate(gaps):
        places = [j + 0.38 * k for j in range(len(columns))]
        ax.bar(places, [1e6 * gap.rmse[c] for c in columns], 0.36, label=label, color=color)
    ax.set_xticks([j + 0.19 for j in range(len(columns))], [c.rpartition("_")[0] for c in columns])
    ax.margins(y=0.2)
    ax.set_ylabel(f"rms error on holdout runs [{unit}]")
axes[0].legend()
