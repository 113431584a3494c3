"""Writing a generated folder: all or nothing, and never over a file that a manifest there does not list.

The manifest holds the SHA-256 of every generated file. A file that is not in it, or that was edited since, is
its owner's: it is neither replaced nor removed.
"""

import json
import re
from collections.abc import Collection, Mapping
from contextlib import ExitStack
from hashlib import sha256
from pathlib import Path, PurePosixPath
from typing import Any

from hallsym.codegen.naming import PREFIX
from hallsym.codegen.templates import MARK
from hallsym.errors import InputError, quoted, require
from hallsym.files import check_output, json_text, reason, replacing

MANIFEST = "manifest.json"
"""Lists what is generated in a folder, with the SHA-256 of each file."""
PROOF = "proof/proof.txt"
"""What `make prove` found: of no use once a table has changed."""
WIDEST_PLAN = 200
"""Largest size of an exponent that a folder is believed: beyond it the record was edited."""
Files = Mapping[str, str | bytes]


def write_folder(folder: Path, files: Files, *, force: bool = False, name: str = PREFIX) -> None:
    """Write `files` (path within the folder -> content) and their manifest.

    Raises `InputError`, before anything is written, where the folder holds other files, or files of ours
    without `force`, or files of ours that were edited.
    """
    require(folder.is_dir() or not folder.exists(), f"Output {quoted(folder)}", "a folder", "a file")
    if not folder.is_dir() or not any(folder.iterdir()):
        check_output(folder)
        _replace(folder, files, name)
        return
    listed = _listed(folder)
    if not listed:
        first = min(p.name for p in folder.iterdir())
        raise InputError(
            f"Folder {quoted(folder)} holds other files ({quoted(first)}) and no {MANIFEST} of generated "
            "code; give an empty or new folder."
        )
    if not force:
        raise InputError(
            f"Folder {quoted(folder)} already holds generated code; give an empty one, --force to replace "
            "generated files, or --params-only to replace the parameters alone."
        )
    _check_ours(folder, listed, {*files, *listed})
    _replace(folder, files, name)
    for old in set(listed) - set(files):
        (folder / old).unlink(missing_ok=True)
    _forget_proof(folder)


def replace_params(folder: Path, files: Files, layout: int, name: str = PREFIX) -> None:
    """Replace the parameter files of a generated folder.

    Raises `InputError` if its code needs another layout.
    """
    path, listed = folder / f"{name_of(folder)}.h", _listed(folder)
    try:
        header = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    except OSError as error:
        raise InputError(f"Cannot read {quoted(path)}: {reason(error)}.") from None
    if not listed:
        raise InputError(
            f"--params-only replaces the parameters of a generated folder; {quoted(folder)} has no "
            f"{MANIFEST} of one: generate the folder first, without --params-only."
        )
    if name != name_of(folder):
        raise InputError(
            f"The code in {quoted(folder)} is called {name_of(folder)}, not {name}; leave --name out, or "
            "generate another folder."
        )
    found = re.search(r"_LAYOUT (0x[0-9A-Fa-f]+)", header)
    if not found or int(found[1], 16) != layout:
        raise InputError(
            f"The code in {quoted(folder)} reads another table than this calibration gives (model, box or "
            "options differ); generate the folder again with --force."
        )
    _check_ours(folder, listed, files)
    _replace(folder, files, name, listed)
    _forget_proof(folder)


def record_of(folder: Path) -> Mapping[str, Any]:
    """Return the record of the table of a generated folder: `table/NAME_params.json`."""
    return _record(folder / "table" / f"{name_of(folder)}_params.json")


def options_of(record: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what the choices of a generated folder came to: given again, they make the same code."""
    found = record.get("options")
    plan = found.get("plan", []) if isinstance(found, dict) else None
    if not (isinstance(plan, list) and all(type(n) is int and abs(n) <= WIDEST_PLAN for n in plan)):
        return {}
    return dict(found or {})


# -- the manifest ------------------------------------------------------------------------------------------


def _record(path: Path) -> Mapping[str, Any]:
    """Return a JSON object of a generated folder; an empty one where there is none."""
    try:
        record = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return record if isinstance(record, dict) else {}


def _listed(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of each generated file of a folder; nothing where there is no manifest of ours."""
    files = _record(folder / MANIFEST).get("files")
    if not isinstance(files, dict):
        return {}
    return {name: str(digest) for name, digest in files.items() if _inside(name)}


def name_of(folder: Path) -> str:
    """Return the prefix that the code in a generated folder has."""
    return str(_record(folder / MANIFEST).get("name", PREFIX))


def _inside(name: str) -> bool:
    """Whether a name in a manifest stays within its folder, whoever wrote it."""
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and "\\" not in name and "\0" not in name


def _check_ours(folder: Path, listed: Mapping[str, str], names: Collection[str]) -> None:
    """Refuse to replace or remove what the manifest does not list as it is now."""
    for name in sorted(names):
        path = folder / name
        if not (path.exists() or path.is_symlink()):
            continue
        if name not in listed:
            raise InputError(
                f"{quoted(path)} was not generated by hallsym; move it away, it is not replaced."
            )
        if path.is_symlink() or not path.is_file() or sha256(path.read_bytes()).hexdigest() != listed[name]:
            raise InputError(
                f"{quoted(path)} was changed since it was generated; move it away to keep it, or delete it "
                "to have it made again."
            )


# -- files -------------------------------------------------------------------------------------------------


def _replace(folder: Path, files: Files, name: str, listed: Mapping[str, str] | None = None) -> None:
    """Replace files and the manifest, which keeps what is `listed`, once all stand beside their place."""
    content = {path: text.encode() if isinstance(text, str) else text for path, text in files.items()}
    digests = {**(listed or {}), **{path: sha256(data).hexdigest() for path, data in content.items()}}
    by = MARK.partition(" (")[0]
    about = f"{by}; what is not listed here, or has another SHA-256, is never replaced or removed."
    record = {"about": about, "name": name, "files": dict(sorted(digests.items()))}
    content[MANIFEST] = f"{json_text(record)}\n".encode()
    with ExitStack() as stack:
        for place, data in content.items():
            path = folder / place
            try:
                path.parent.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(f"Cannot write {quoted(path)}: {reason(error)}.") from error
            stack.enter_context(replacing(path)).write_bytes(data)


def _forget_proof(folder: Path) -> None:
    path = folder / PROOF
    if path.is_file() and path.read_bytes().startswith(b"Generated by hallsym codegen"):
        path.unlink()
