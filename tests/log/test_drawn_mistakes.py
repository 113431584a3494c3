"""Mistakes of a size drawn by a seed, in healthy logs of any kind: those that another threshold would miss.

Each was found by changing one threshold by a factor two.
"""

from __future__ import annotations

import re

import pytest
from drawn_mistakes import drawn

from hallsym.errors import InputError
from hallsym.log import Log, check_log

FOUND = (
    ("rail", "turning", 0),
    ("twice", "raster", 7),
    ("held", "multisine", 2),
    ("held", "grid", 2),
    ("held", "multisine", 4),
    ("held", "resting", 6),
)


@pytest.mark.parametrize(("mistake", "kind", "seed"), FOUND)
def test_a_drawn_mistake_is_named(mistake: str, kind: str, seed: int) -> None:
    arrays, says = drawn(mistake, kind, seed)
    try:
        said = check_log(Log.from_arrays(arrays))
    except InputError as error:
        said = [str(error)]
    assert any(re.search(says, text) for text in said), said
