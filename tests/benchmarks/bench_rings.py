"""How often the 95 % intervals of waves of an encoder without a reference hold the true waves.

python tests/benchmarks/bench_rings.py [--rings 200] [--first 0]

Ring `seed` has 1 to 7 pole pairs, two to four Halls (half of the rings at even places), harmonics of 0.5 to
4 %, noise of 0.05 to 0.5 %, 2.2 to 8.2 turns, and a ripple of 0.1 to 2 electrical deg at a wave of 1 to 12
per turn: kinematic of a motor at constant speed, or cogging of a rotor that coasts at two speeds. Prints, by
number of Halls and by way, waves with a stated error and the share within 95 %.
"""

from __future__ import annotations

import argparse
import sys
from collections import defaultdict
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from rings import TURN, recorded, ring

from hallsym.errors import InputError
from hallsym.estimation import self_calibration as sc

WITHIN = 3.0
"""Half of chi-square of two degrees of freedom at 95 %."""


def scores(seed: int) -> tuple[int, str, list[float]]:
    """Return the number of Halls, the way, and half of chi-square of each wave that has an error."""
    rng = np.random.default_rng(seed)
    pairs, halls = int(rng.integers(1, 8)), int(rng.integers(2, 5))
    even = TURN / (4 if halls == 2 else halls) * np.arange(halls)
    places = even if rng.random() < 0.5 else np.cumsum([0.0, *rng.uniform(0.8, 1.9, halls - 1)])
    own = ring(seed, pairs, places, size=rng.uniform(0.005, 0.04))
    way = str(rng.choice(["none", "constant-speed", "coasting"]))
    ripple = np.radians(rng.uniform(0.1, 2.0)) / pairs
    kind = {"cogging" if way == "coasting" else "kinematic": ripple, "order": int(rng.integers(1, 13))}
    kind |= {"turns": int(rng.integers(2, 9)) + 0.2, "noise": 5e-4 * 10 ** rng.uniform(0, 1)}
    speeds = (1.0, 2.0) if way == "coasting" else (1.0,)
    logged = {k: recorded(own, 10 * seed + k, speed=speed, **kind) for k, speed in enumerate(speeds)}
    found = sc.self_calibrate(logged, pairs, np.array(places), way)
    truth = own.table(found.plane, len(found.waves))
    pairs_of = zip(found.waves, truth, strict=True)
    return halls, way, [abs(w.sensor - h) ** 2 / (2 * w.std**2) for w, h in pairs_of if w.std is not None]


def main() -> None:
    """Print the shares."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--rings", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    told = parser.parse_args()
    found: dict[str, list[float]] = defaultdict(list)
    far, refused = 0, 0
    for seed in range(told.first, told.first + told.rings):
        try:
            halls, way, each = scores(seed)
        except InputError as error:
            refused += 1
            print(f"ring {seed}: {error}")
            continue
        far += max(each, default=0.0) > 12.5
        for name in ("all", f"{halls} Halls", way):
            found[name] += each
    for name, each in sorted(found.items()):
        print(f"{name:16} {len(each):5} waves  {100 * np.mean(np.array(each) < WITHIN):5.1f} % within 95 %")
    print(f"{far} rings with a wave beyond five standard errors; {refused} refused")


if __name__ == "__main__":
    main()
