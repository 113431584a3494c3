"""Stage logs made of sines and noise, with faults to put in."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from scipy.io import savemat

from hallsym.errors import InputError
from hallsym.log import check_log, read_log, write_log

STAGE = ("run", "t_s", "hall_a_m", "hall_b_m", "z_m", "x_ref_m", "y_ref_m", "rz_ref_rad")


def stage_arrays(runs: int = 4, samples: int = 400, seed: int = 0) -> dict[str, np.ndarray]:
    """A healthy log: combined motion of +-0.5 mm, noise 0.5 um, 2 ms clock, a pause between runs."""
    rng = np.random.default_rng(seed)
    n = runs * samples
    run = np.repeat(np.arange(runs), samples)
    t = np.arange(n) * 0.002 + run * 10.0
    x, y, rz = (5e-4 * np.sin(2 * np.pi * f * t + f) for f in (1.3, 1.9, 2.3))
    noisy = {"hall_a_m": y + 0.2 * rz, "hall_b_m": y - 0.2 * rz, "z_m": 1e-4 * np.sign(run - 1.5)}
    noisy |= {"x_ref_m": x, "y_ref_m": y, "rz_ref_rad": rz}
    columns = {name: values + 5e-7 * rng.normal(size=n) for name, values in noisy.items()}
    return {"run": run, "t_s": t, **columns}


def one_sentence(message: str) -> bool:
    """A message for a person: one line, ends with a full stop, not a traceback."""
    return "\n" not in message and message.endswith(".") and 20 < len(message) < 500


@contextmanager
def refusal(says: str, name: str = "") -> Iterator[None]:
    """What is done within is refused in one sentence."""
    with pytest.raises(InputError, match=says) as caught:
        yield
    assert one_sentence(str(caught.value)), caught.value
    assert name in str(caught.value)


def refused(path: Path, says: str, **options: Any) -> None:
    """A file is refused in one sentence that names it."""
    with refusal(says, path.name):
        check_log(read_log(path, **options))


def save(columns: Mapping[str, np.ndarray], path: Path) -> None:
    """Write a log, in a format that is only read by its own library."""
    if path.suffix == ".h5":
        with h5py.File(path, "w") as file:
            for name, values in columns.items():
                file.create_dataset(name, data=values, chunks=True, fletcher32=True)
    elif path.suffix == ".mat":
        savemat(path, dict(columns), oned_as="column", do_compression=True)
    else:
        write_log(columns, path)
