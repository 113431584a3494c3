"""From a calibration to the files of a decoupler."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from hallsym.codegen import proof, selftest, source_check
from hallsym.codegen.bounds import Bounds, bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.checks import check, check_bounds, check_gains, check_same, digest_of, notes_of
from hallsym.codegen.families import decoupler
from hallsym.codegen.folder import BINARY, replace_params, write_folder
from hallsym.codegen.printer import DOUBLE, FLOAT, straight
from hallsym.codegen.project import count, makefile, template
from hallsym.codegen.report import report
from hallsym.codegen.source import Source
from hallsym.codegen.source_header import header, params, params_header
from hallsym.codegen.source_step import bare, step
from hallsym.codegen.table import Table
from hallsym.codegen.vectors import worst
from hallsym.errors import InputError
from hallsym.estimation.calibration import Fit


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
            "error_bound": {c: error + d.slack for c, error in self.bounds.error.items()},
            "error_met": dict(self.errors),
            "least_gain": dict(self.bounds.least_gain),
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
    accuracy: float | None = None,
    correction: str | None = None,
    allow_undetermined: bool = False,
    calibration_sha256: str | None = None,
) -> Generated:
    """Generate the C decoupler of a calibration.

    `ranges`: least and greatest value by column [SI] in place of what the log recorded. `double`: for hosts.
    `jacobian`: with `decoupler_jacobian()`. Encoders: `accuracy` is what the correction of the angle may
    leave besides rounding [rad], default 3e-8; `correction` is "series", "table", or "auto" for the one of
    fewer bytes. Raises `InputError` for a calibration that cannot be trusted on a controller.
    """
    check(fit, allow_undetermined)
    found = decoupler(fit, box_of(fit, ranges), given(accuracy, correction))
    if jacobian and found.bounded is not None:
        raise InputError(
            f"--jacobian is not generated for {found.model.name} of the family {found.model.family}, whose "
            "rounding is bounded by an argument of its own that does not cover slopes; leave it out."
        )
    real = DOUBLE if double else FLOAT
    said = bounds(found, real.digits)
    check_gains(said)
    check_bounds(found, said)
    check_same(found)
    digest = calibration_sha256 or digest_of(fit)
    record = {"model": fit.model.name, "calibration_sha256": digest, **recorded(found.options, accuracy)}
    table = Table(found, real, record)
    source = Source(table, jacobian)
    errors = worst(found, real)
    notes = notes_of(fit)
    return Generated(source, _files(source, said, errors, notes), said, errors, notes)


def given(accuracy: float | None, correction: str | None) -> dict[str, Any]:
    """Return the options of a family that are given, by name."""
    options = {"accuracy": accuracy, "correction": correction}
    return {name: value for name, value in options.items() if value is not None}


def recorded(options: Mapping[str, Any], accuracy: float | None) -> dict[str, Any]:
    """Return the choices of a family as `params/decoupler_params.json` holds them, for a recalibration."""
    return {"options": {**options, **given(accuracy, None)}} if options else {}


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


# -- files -------------------------------------------------------------------------------------------------


def _files(
    source: Source, found: Bounds, errors: dict[str, float], notes: tuple[str, ...]
) -> dict[str, str | bytes]:
    files: dict[str, str | bytes] = {
        "include/decoupler.h": header(source),
        "src/decoupler.c": step(source),
        "src/decoupler_check.c": source_check.check(source),
        "params/decoupler_params.h": params_header(source),
        "params/decoupler_params.c": params(source),
        "params/decoupler_params.json": source.table.json(),
        BINARY: source.table.binary,
        "test/selftest.h": template("selftest.h"),
        "test/selftest.c": selftest.selftest(source),
        "test/selftest_vectors.h": selftest.selftest_vectors(source, dict(found.error)),
        "test/main.c": selftest.main(source),
        "test/count.c": count(source),
        "test/bare.c": bare(source),
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
        if straight(source.d.steps):
            files["proof/rounding.g"] = proof.gappa(source, found)
    return files
