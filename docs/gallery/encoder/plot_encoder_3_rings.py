"""
Rings without a reference, and what constant speed would teach
==============================================================

Ten magnet rings under the three Halls of one jig, turned by a drive whose speed ripples ten times a turn. A
table from constant speed takes that ripple for an error of each ring; Halls that see one field tell the two
apart (left). Ring 7 is knocked in its last turn, which shows in the error there (right).
"""

import matplotlib.pyplot as plt
import numpy as np

import hallsym
from hallsym.fleets import ring_fleet
from hallsym.log import Log, Meta

PAIRS, TURN = 4, 2 * np.pi
NAMES = ("hall1_count", "hall2_count", "hall3_count")
places = np.radians([0, 101, 262]) / PAIRS
waves = np.arange(1, 24)
rng = np.random.default_rng(3)
angle = 0.3 + TURN * np.arange(4.2 * 600) / 600
angle += np.radians(0.1) * np.cos(10 * angle)  # the drive: 0.4 electrical deg


def readings(field, theta):
    """Return the counts of three Halls that see one field, as phasors per turn, at angles [rad]."""
    seen = [(np.exp(1j * np.outer(theta + place, waves)) @ field).real for place in places]
    return 2048 + 900 * np.stack(seen)


rings, fields = {}, {}
for k in range(10):
    field = 0.03 * (rng.normal(size=23) + 1j * rng.normal(size=23)) / (1 + abs(waves - PAIRS))
    field[PAIRS - 1] = 1
    knock = np.radians(0.6) * np.exp(-(((angle - angle[-300]) / 0.1) ** 2)) * (k == 7)
    counts = readings(field, angle + knock) + rng.normal(0, 2, (3, len(angle)))
    meta = Meta(raw={"encoder": {"pole_pairs": PAIRS}}, columns=NAMES)
    rings[f"ring {k}"] = Log.from_arrays(dict(zip(NAMES, counts, strict=True)), meta=meta)
    fields[f"ring {k}"] = field

if __name__ == "__main__":  # the rings are calibrated in other processes
    fleet = ring_fleet(rings, "rings3", workers=1)
    print(fleet.sentence)
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3.4), layout="constrained")
    for name in fleet.fits:
        alone = hallsym.fit_without_reference(rings[name], "rings3", "constant-speed").found
        turn = np.arange(4096) * TURN / 4096
        u = alone.plane.phase(readings(fields[name], turn).T) / PAIRS
        true = np.array([2 * np.mean((turn - u) * np.exp(-1j * n * u) * np.gradient(u)) for n in waves])
        true *= 4096 / TURN
        kept = np.array([wave.sensor for wave in alone.waves[:23]])
        motion = np.array([(wave.verdict == "motion") * (wave.motion or 0) for wave in alone.waves[:23]])
        for table, look in ((kept - motion, {"color": "0.65"}), (kept, {"color": "0.1"})):
            left.plot(waves, np.degrees(abs(table - true)) * PAIRS, ".", ms=4, **look)
    left.plot([], [], ".", color="0.65", label="learned from constant speed")
    left.plot([], [], ".", color="0.1", label="with Halls that see one field")
    left.set(xlabel="wave per turn", ylabel="error of the table [electrical deg]", ylim=(0, None))
    left.legend(loc="center right")
    order = [row["device"] for row in fleet.fleet.rows]
    for name, shade in (("nominal", "0.85"), ("ellipse", "0.65"), ("table", "0.1")):
        size = [np.degrees(fleet.fits[ring].found.left[name][1]) for ring in order]
        label = {"nominal": "nominal places", "ellipse": "ellipse alone", "table": "table"}[name]
        right.plot(size, order, "o", ms=5, color=shade, label=label)
    right.set(xlabel="error on the last turn, less the ripple [electrical deg]", xscale="log")
    right.set_xticks([0.1, 0.2, 0.5, 1, 2, 5, 10], ["0.1", "0.2", "0.5", "1", "2", "5", "10"])
    right.minorticks_off()
    right.legend(loc="lower center", bbox_to_anchor=(0.5, 1), ncols=3)
    plt.show()
