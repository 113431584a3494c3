"""Recordings and cases that lie in `shared` beside a checkout; a test that needs them is skipped without."""

import os
from pathlib import Path

import pytest

ABOVE = Path(__file__).resolve().parents[2:]
SHARED = next((folder / "shared" for folder in ABOVE if (folder / "shared").is_dir()), ABOVE[0] / "shared")
CASES = Path(os.environ.get("HALLSYM_CASES", SHARED / "cases"))
REAL = CASES.parent / "real"


def needs(path: Path) -> pytest.MarkDecorator:
    """Skip a test, and say so, where a file or folder is not there."""
    return pytest.mark.skipif(not path.exists(), reason=f"{path.name} is not beside this checkout")
