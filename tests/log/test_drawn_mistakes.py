"""Drawn logs that another threshold would judge wrongly: mistakes it would miss, healthy logs it would note.

Each was found by changing one threshold by a factor two.
"""

from __future__ import annotations

import re

import pytest
from drawn_mistakes import drawn
from healthy_logs import healthy

from hallsym.errors import InputError
from hallsym.log import Log, check_log

FOUND = (
    ("rail", "turning", 0),
    ("twice", "raster", 7),
    ("held", "multisine", 2),
    ("held", "grid", 2),
    ("held", "multisine", 4),
    ("held", "resting", 6),
    ("rail", "dwell", 36),
    ("rail", "dwell", 37),
    ("rail", "dwell", 92),
    ("rail", "grid", 34),
    ("rail", "raster", 6),
    ("rail", "resting", 19),
    ("rail", "swinging", 48),
    ("rail", "turning", 3212),
    ("dead", "dwell", 4),
    ("dead", "swinging", 5),
    ("old", "raster", 6),
    ("twice", "turning", 3),
)
SILENT = (("turning", 2043), ("turning", 2081), ("turning", 2143), ("resting", 11), ("dwell", 2041))


@pytest.mark.parametrize(("mistake", "kind", "seed"), FOUND)
def test_a_drawn_mistake_is_named(mistake: str, kind: str, seed: int) -> None:
    arrays, says = drawn(mistake, kind, seed)
    try:
        said = check_log(Log.from_arrays(arrays))
    except InputError as error:
        said = [str(error)]
    assert any(re.search(says, text) for text in said), said


@pytest.mark.parametrize(("kind", "seed"), SILENT)
def test_a_drawn_healthy_log_passes_silently(kind: str, seed: int) -> None:
    assert check_log(Log.from_arrays(healthy(kind, seed))) == []
