"""What an encoder's log is looked at for must not grow with the log."""

import tracemalloc

import numpy as np

from hallsym.families.rotary.seen import MANY, Some


def test_numbers_taken_from_a_long_stream_hold_nothing_else_of_it() -> None:
    kept = Some(np.empty((2, 0)))
    tracemalloc.start()
    for k in range(2000):  # 130 MB go by
        kept.add(np.full((2, 4096), float(k)))
    held, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert kept.count == 2000 * 4096
    assert MANY / 2 <= kept.values.shape[-1] <= MANY
    assert held < 2 * 2 * 8 * MANY
    assert np.all(np.diff(kept.values[0]) >= 0)
