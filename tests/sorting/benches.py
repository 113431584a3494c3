"""A simulated sorting bench: a magnet that drifts, a reference sensor, sensors inserted one by one."""

import numpy as np

FIELD = 0.475


def bench(n=600, repeats=150, seed=0, walk=2e-5):
    """Columns of a table with one row a measurement, and the true gains [V/T] by name.

    Seats and the reference sensor scatter by .1 %, gains by 3 %; `walk`: of the field from one to the next.
    """
    rng = np.random.default_rng(seed)
    gain = 2.0 * (1 + rng.normal(0, 0.03, n))
    offset = rng.normal(0, 5e-3, n)
    order = np.r_[np.arange(n), rng.choice(n, repeats, replace=False)]
    m = len(order)
    field = FIELD * (1 + np.cumsum(rng.normal(0, walk, m)))
    names = np.array([f"R1-{k:05d}" for k in range(n)])
    table = {
        "sensor": names[order],
        "t_s": 25.0 * np.arange(m),
        "field_0_t": np.zeros(m),
        "reading_0_v": offset[order],
        "reference_0_v": np.full(m, 1e-3),
        "field_1_t": np.full(m, FIELD),
        "reading_1_v": offset[order] + gain[order] * field * (1 + rng.normal(0, 1e-3, m)),
        "reference_1_v": 1e-3 + 1.9 * field * (1 + rng.normal(0, 1e-3, m)),
    }
    return table, dict(zip(names.tolist(), gain.tolist(), strict=True))


def truth(found, gains):
    """True gains of the sorted sensors on the bench's own scale, which its drift leaves open."""
    true = np.array([gains[name] for name in found.sensors])
    return true * np.mean(found.gain / true)


def long_form(table):
    """The same readings in mT and mV, one row each: first the zero field, then the other."""
    both = {
        name: 1e3 * np.stack([table[f"{name}_0_{unit}"], table[f"{name}_1_{unit}"]], axis=1).ravel()
        for name, unit in (("field", "t"), ("reading", "v"), ("reference", "v"))
    }
    return {
        "sensor": np.repeat(table["sensor"], 2),
        "t_s": np.repeat(table["t_s"], 2) + np.tile([0.0, 9.0], len(table["sensor"])),
        "field_mt": both["field"],
        "reading_mv": both["reading"],
        "reference_mv": both["reference"],
    }


def written(path, table):
    """Write a table as CSV."""
    rows = zip(*(v.tolist() for v in table.values()), strict=True)
    path.write_text("\n".join([",".join(table), *(",".join(map(str, row)) for row in rows)]) + "\n")
    return path
