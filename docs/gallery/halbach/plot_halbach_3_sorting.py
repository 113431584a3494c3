"""
Sensors that were measured twice
================================

Of 799 sensors of one bin, how many came out in a neighbouring bin the second time: counted by the
thesis, and predicted from a drift of -0.049 % and a scatter of 0.157 % between the measurements.
"""

import matplotlib.pyplot as plt

import hallsym

changes, counted = [-2, -1, 0, 1], [1, 144, 588, 66]
predicted = [
    799 * hallsym.change_probability(change, width=0.005, drift=-0.049e-2, std=0.157e-2) for change in changes
]
figure, ax = plt.subplots(figsize=(5, 3), layout="constrained")
ax.bar([c - 0.2 for c in changes], counted, 0.38, color="0.75", label="counted")
ax.bar([c + 0.2 for c in changes], predicted, 0.38, color="0.25", label="predicted")
ax.set(xlabel="change of bin", ylabel="sensors", xticks=changes)
ax.legend()
