"""From a calibration to the files of a decoupler."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hallsym.calibration import Fit
from hallsym.codegen import proof, selftest
from hallsym.codegen.bounds import LEAST_PHI, Bounds, bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.expressions import check_columns, decoupler
from hallsym.codegen.folder import BINARY, replace_params, write_folder
from hallsym.codegen.parts import Decoupler
from hallsym.codegen.printer import DOUBLE, FLOAT, Real
from hallsym.codegen.project import count, makefile, template
from hallsym.codegen.report import report
from hallsym.codegen.source import Source
from hallsym.codegen.table import Table, sha256
from hallsym.codegen.vectors import worst
from hallsym.errors import InputError

SAME = 1e-9
"""Largest difference [m, rad] between the printed expressions in double and the model's own decoded pose."""


@dataclass(frozen=True, eq=False)
class Generated:
    """What `generate` made: files by path, bounds, largest errors met, and notes."""

    source: Source
    files: Mapping[str, str | bytes]
    bounds: Bounds
    errors: Mapping[str, float]
    notes: tuple[str, ...]

    @property
    def params(self) -> dict[str, str | bytes]:
        """The files that a recalibration replaces."""
        return {name: content for name, content in self.files.items() if name.startswith(REPLACED)}

    def write(self, folder: str | Path, *, force: bool = False, params_only: bool = False) -> None:
        """Write the folder, or only its parameters. Raises `InputError` before anything is written."""
        if params_only:
            replace_params(Path(folder), self.params, self.source.table.layout)
        else:
            write_folder(Path(folder), self.files, force=force)

    def to_dict(self) -> dict[str, Any]:
        """Return the readable record."""
        d, table = self.source.d, self.source.table
        return {
            "model": d.model.name,
            "type": table.real.name,
            "layout": f"0x{table.layout:08x}",
            "crc32": f"0x{table.crc:08x}",
            "table_bytes": len(table.binary),
            "calibration_sha256": table.source["calibration_sha256"],
            "box": {c: list(d.ends(c)) for c in d.inputs},
            "error_bound": dict(self.bounds.error),
            "error_met": dict(self.errors),
            "least_gain": dict(self.bounds.least_phi),
            "files": sorted(self.files),
            "notes": list(self.notes),
        }


REPLACED = (
    "params/",
    "test/selftest_vectors.h",
    "doc/report.md",
    "proof/eva.c",
    "proof/cbmc.c",
    "proof/rounding.g",
)


def generate(
    fit: Fit,
    *,
    ranges: Mapping[str, tuple[float, float]] | None = None,
    double: bool = False,
    jacobian: bool = False,
    allow_undetermined: bool = False,
    calibration_sha256: str | None = None,
) -> Generated:
    """Generate the C decoupler of a calibration.

    `ranges`: least and greatest value by column [SI] in place of what the log recorded. `double`: for hosts.
    `jacobian`: with `decoupler_jacobian()`. Raises `InputError` for a calibration that cannot be trusted on a
    controller.
    """
    check_columns(fit.model)
    check(fit, allow_undetermined)
    found = decoupler(fit, box_of(fit, ranges))
    real = DOUBLE if double else FLOAT
    said = bounds(found, real.digits)
    check_gains(said)
    digest = calibration_sha256 or digest_of(fit)
    table = Table(found, real, {"model": fit.model.name, "calibration_sha256": digest})
    source = Source(table, jacobian)
    errors = worst(found, real)
    _check_errors(found, real, errors, said)
    notes = notes_of(fit)
    return Generated(source, _files(source, said, errors, notes), said, errors, notes)


def decouple(fit: Fit) -> ca.Function:
    """Return the decoupled pose as a CasADi function `(reading, state) -> pose`, parameters as numbers.

    Columns in SI: `reading` (n_channels,), `state` (n_state,), `pose` (n_pose,); zero deviations are 0. The
    route for those who build with CasADi; `generate` writes C without it.
    """
    model = fit.model
    reading, state = ca.SX.sym("reading", len(model.channels)), ca.SX.sym("state", len(model.state))
    weight = 1.0 / np.array([fit.noise.sigmas[c].value for c in model.channels]) ** 2
    pose = model.decoded(fit.values, np.zeros(len(model.zeros)), reading, state, weight)
    return ca.Function("decouple", [reading, state], [pose], ["reading", "state"], ["pose"])


def digest_of(fit: Fit) -> str:
    """Return the SHA-256 of a calibration that is in no file."""
    return sha256(json.dumps(fit.to_dict(), sort_keys=True).encode())


# -- checks ------------------------------------------------------------------------------------------------


def check(fit: Fit, allow_undetermined: bool) -> None:
    """Refuse a calibration that a controller cannot trust."""
    if fit.status != "converged":
        raise InputError(
            f"The fit did not converge ({fit.status}); a controller needs one that did: fit the log again."
        )
    if not np.all(np.isfinite(fit.values)):
        raise InputError("The calibration holds values that are not finite; fit the log again.")
    if fit.undetermined_by_log and not allow_undetermined:
        names = ", ".join(fit.undetermined_by_log)
        raise InputError(
            f"The log of this calibration does not determine {names}, which the decoded pose depends on; "
            "record runs that move what they belong to, or give --allow-undetermined to use the values they "
            "were held at."
        )


def check_gains(found: Bounds) -> None:
    """Refuse a box within which a gain comes near zero."""
    for channel, share in found.least_phi.items():
        if not share >= LEAST_PHI:
            raise InputError(
                f"Within the box the gain of {channel} falls to {100 * share:.0f} % of its gain at rest, and "
                "what is decoded grows without bounds where it crosses zero; give a smaller box with --range."
            )


def _check_errors(d: Decoupler, real: Real, errors: Mapping[str, float], found: Bounds) -> None:
    """The printed expressions are the model's, or the model is none that can be printed."""
    for column, error in errors.items():
        if not error <= found.error[column] + SAME:
            raise InputError(
                f"The generated {column} differs by {error:.3g} from model {d.model.name}: its readings are "
                "no polynomial of pose and state times a gain, and C cannot be generated for it."
            )


def notes_of(fit: Fit) -> tuple[str, ...]:
    """Return what a user of the code should know of the calibration."""
    notes = []
    if fit.structural:
        notes.append(
            f"No recording tells {', '.join(fit.structural)} apart; only the combinations that readings "
            "depend on are used, and those are determined."
        )
    if fit.undetermined_by_log:
        notes.append(
            f"The log does not determine {', '.join(fit.undetermined_by_log)}; the values they were held at "
            "are used."
        )
    if fit.at_bound:
        notes.append(f"{', '.join(fit.at_bound)} ended at a bound.")
    return tuple(notes)


# -- files -------------------------------------------------------------------------------------------------


def _files(
    source: Source, found: Bounds, errors: dict[str, float], notes: tuple[str, ...]
) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {
        "include/decoupler.h": source.header(),
        "src/decoupler.c": source.step(),
        "src/decoupler_check.c": source.check(),
        "params/decoupler_params.h": source.params_header(),
        "params/decoupler_params.c": source.params(),
        "params/decoupler_params.json": source.table.json(),
        BINARY: source.table.binary,
        "test/selftest.h": template("selftest.h"),
        "test/selftest.c": selftest.selftest(source),
        "test/selftest_vectors.h": selftest.selftest_vectors(source, dict(found.error)),
        "test/main.c": selftest.main(source),
        "test/count.c": count(source),
        "test/bare.c": source.bare(),
        "test/count.sh": template("count.sh"),
        "test/startup.c": template("startup.c"),
        "test/cortex_m.ld": template("cortex_m.ld"),
        "proof/eva.c": proof.eva(source, found),
        "proof/cbmc.c": proof.cbmc(source, found),
        "proof/prove.sh": template("prove.sh"),
        "doc/report.md": report(source, found, errors, notes),
        "doc/misra.txt": template("misra.txt"),
        "CMakeLists.txt": template("CMakeLists.txt"),
        "Makefile": makefile(source),
    }
    if source.real.size == 4:
        files["proof/exhaustive.c"] = proof.exhaustive(source)
        files["proof/rounding.g"] = proof.gappa(source, found)
    return files
