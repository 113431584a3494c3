"""Record golden results anew: `OPENBLAS_NUM_THREADS=1 python tests/goldens/regenerate.py NAME ...`.

The goldens pin what the program says of a few logs: fits, diagnoses, and generated C byte for byte. Do not
regenerate one to make a test pass. Regenerate one only where a change was meant to change that very result,
name it (`fit/bundled_campaign`, or `diagnosis/` for all of these), look at the difference in the commit, and
let the message of the commit say why the new result is right.
"""

import json
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from golden_results import GOLDENS  # noqa: E402

DIGITS = {"fit": 13, "diagnosis": 6}


def rounded(value: Any, digits: int) -> Any:
    """Return a result with no more digits than are compared."""
    if isinstance(value, dict):
        return {k: rounded(v, digits) for k, v in value.items()}
    if isinstance(value, list):
        return [rounded(v, digits) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value


def written(value: Any, depth: int = 1) -> str:
    """Return JSON in which a list or an object stands on one line if it fits."""
    text, space = json.dumps(value), " " * depth
    if not isinstance(value, dict | list) or len(text) + depth <= 110:
        return text
    named = isinstance(value, dict)
    keys = [f"{json.dumps(k)}: " for k in value] if named else [""] * len(value)
    each = (k + written(v, depth + 1) for k, v in zip(keys, value.values() if named else value, strict=True))
    inside = f",\n{space}".join(each)
    return f"{'{['[not named]}\n{space}{inside}\n{space[1:]}{'}]'[not named]}"


if __name__ == "__main__":
    for name, golden in GOLDENS.items():
        if any(name == w or (w.endswith("/") and name.startswith(w)) for w in sys.argv[1:]):
            result = rounded(golden.make(), DIGITS.get(golden.kind, 17))
            (HERE / f"{name}.json").write_text(written(result) + "\n", encoding="utf-8")
            print(f"recorded {name}")
