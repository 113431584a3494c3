"""Record golden results anew: `python tests/goldens/regenerate.py [NAME ...]`.

The goldens pin what the program says: fits, diagnoses, the objects that commands print with --json, and
generated C byte for byte. They are not to be regenerated to make a test pass. Regenerate one only where a
change was meant to change that very result, name it (`fit/stage31_late`, or `diagnosis/` for all of these),
look at the difference in the commit, and let the message of the commit say why the new result is right. A
change that only moves or renames code changes no golden.

Without a name everything is recorded; logs beside the project that are absent are left as they are. The
calibrations that C is generated from are fitted anew only by the name `calibrations`: their digest is in
every generated folder. Set OPENBLAS_NUM_THREADS=1, as `make test` does.
"""

import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parents[1])]

from golden_logs import Absent  # noqa: E402
from golden_results import GOLDENS, save_calibrations  # noqa: E402


def rounded(value: Any, kind: str) -> Any:
    """Return a result with no more digits than are compared."""
    digits = {"fit": 13, "diagnosis": 6, "json": 10}.get(kind)
    if isinstance(value, dict):
        return {k: rounded(v, kind) for k, v in value.items()}
    if isinstance(value, list):
        return [rounded(v, kind) for v in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) and digits else value


def written(value: Any, indent: int = 0) -> str:
    """Return JSON with a line for each key, and with lists and small objects on one line."""
    flat = json.dumps(value)
    if not isinstance(value, dict | list) or len(flat) + indent <= 110:
        return flat
    pad = " " * (indent + 1)
    if isinstance(value, list):
        lines = [pad + written(v, indent + 1) for v in value]
        return "[\n" + ",\n".join(lines) + "\n" + " " * indent + "]"
    lines = [f"{pad}{json.dumps(k)}: {written(v, indent + 1)}" for k, v in value.items()]
    return "{\n" + ",\n".join(lines) + "\n" + " " * indent + "}"


def save(path: Path, text: str) -> None:
    """Write a file that is complete or not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8") as file:
        file.write(text)
    os.chmod(file.name, 0o644)
    os.replace(file.name, path)


def main(wanted: list[str]) -> None:
    """Record the goldens whose names begin with one of `wanted`, or all."""
    if "calibrations" in wanted:
        save_calibrations()
        wanted = [name for name in wanted if name != "calibrations"]
        if not wanted:
            return
    chosen = [
        n
        for n in GOLDENS
        if not wanted or any(n == w or (w.endswith("/") and n.startswith(w)) for w in wanted)
    ]
    if not chosen:
        sys.exit(f"No golden is called {' or '.join(wanted)}; there are {', '.join(GOLDENS)}.")
    for name in chosen:
        golden = GOLDENS[name]
        try:
            result = golden.make()
        except Absent as absent:
            print(absent)
            continue
        save(HERE / f"{name}.json", written(rounded(result, golden.kind)) + "\n")
        print(f"recorded {name}")


if __name__ == "__main__":
    main(sys.argv[1:])
