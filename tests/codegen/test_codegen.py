"""What C is generated from: the printed expressions against the model, rounding, bounds, refusals, folders.

Independent facts: the model's own decoded pose in double; weighted least squares by numpy; zlib's CRC-32;
interval bounds against random points.
"""

import hashlib
import json
import struct
import zlib

import numpy as np
import pytest
from calibrations import made
from firmware import GOLDEN, calibration, four_probes, with_effect

from hallsym.cli.main import main
from hallsym.codegen import generate
from hallsym.codegen.bounds import pose_bounds
from hallsym.codegen.box import box_of
from hallsym.codegen.decoupler import steps_on_arrays
from hallsym.codegen.float_backend import FloatBackend
from hallsym.codegen.lowering import lower
from hallsym.families import adapted, effects


def inputs_of(d, count=2000, seed=0, dtype=float):
    low, high = np.array([d.ends(c) for c in d.inputs]).T[:, :, None]
    return (low + (high - low) * np.random.default_rng(seed).random((len(low), count))).astype(dtype)


def test_float_errors_over_a_million_inputs():
    d = lower(calibration(), box_of(calibration()))
    met = FloatBackend(d, {}).errors(1_000_000)
    assert max(met["x_m"], met["y_m"]) <= 0.6e-9
    assert met["rz_rad"] <= 3e-9


def test_a_users_effect_follows_into_table_and_code():
    plain, bent = made("stage31"), made("user's height_quadratic")
    names = {e.name for e in bent.decoupler.table} - {e.name for e in plain.decoupler.table}
    assert names == {"gain_hall_a_z_z", "gain_hall_b_z_z", "gain_hall_c_z_z"}
    assert "p->gain_hall_a_z_z * z_z" in str(bent.files["decoupler.c"])
    assert bent.backend.layout != plain.backend.layout
    entry = next(e for e in bent.decoupler.table if e.name == "gain_hall_a_z_z")
    rest = next(e for e in bent.decoupler.table if e.name == "gain_hall_a")
    assert entry.value / rest.value == pytest.approx(3e5 / calibration().value("eta_A"), rel=1e-12)
    assert entry.unit == "1/m2"


def test_more_probes_than_coordinates_are_weighted_least_squares():
    fit = four_probes()
    d = lower(fit, box_of(fit))
    p = dict(zip(fit.model.names, fit.values, strict=True))
    rng = np.random.default_rng(3)
    state = rng.uniform(-2e-4, 2e-4, 3)
    readings = rng.uniform(-3e-4, 3e-4, 4)
    rows, seen, weights = [], [], []
    for k, probe in enumerate(fit.model.layout):
        phi = p[f"eta_{probe.label}"] + state @ [p[f"{q}_{probe.label}"] for q in "abc"]
        turn = p[f"theta_{probe.label}"]
        nx, ny = probe.senses
        nx, ny = nx * np.cos(turn) - ny * np.sin(turn), ny * np.cos(turn) + nx * np.sin(turn)
        x, y = probe.position
        rows.append([nx, ny, x * ny - y * nx])
        seen.append(readings[k] / phi)
        weights.append(p[f"eta_{probe.label}"] / fit.noise.sigmas[probe.channel].value)
    w = np.array(weights)
    expected = np.linalg.lstsq(np.array(rows) * w[:, None], np.array(seen) * w, rcond=None)[0]
    found = steps_on_arrays(d)(np.concatenate([readings, state])[:, None], d.constants)[0].ravel()
    assert np.abs(found - expected).max() < 1e-15


def test_binary_and_json_are_the_same_table():
    code = made("stage31")
    binary = code.files["table/decoupler_params.bin"]
    record = json.loads(code.files["table/decoupler_params.json"])
    crc, version, layout, length, *_ = struct.unpack_from("<6I", binary)
    constant = len(record["parameters"]) - 3  # without the zeros
    values = struct.unpack_from(f"<{constant}f", binary, 24)
    covered = 24 + constant * 4
    (zeros_crc,) = struct.unpack_from("<I", binary, covered)
    zeros = binary[covered + 4 :]
    assert [e["value"] for e in record["parameters"]] == [*values, 0.0, 0.0, 0.0]
    assert (version, f"0x{layout:08x}", f"0x{crc:08x}") == (3, record["layout"], record["crc32"])
    assert length == len(binary)
    assert binary[16:24].hex() != "0" * 16
    assert crc == zlib.crc32(binary[4:covered])
    assert zeros == bytes(3 * 4)
    assert zeros_crc == zlib.crc32(zeros)
    assert len(binary) == 136


def test_the_table_names_its_calibration(tmp_path, capsys):
    assert main(["codegen", str(GOLDEN / "calib.json"), "-o", str(tmp_path / "fw"), "--json"]) == 0
    record = json.loads(capsys.readouterr().out)
    digest = hashlib.sha256((GOLDEN / "calib.json").read_bytes()).hexdigest()
    assert record["calibration_sha256"] == digest
    binary = (tmp_path / "fw/table/decoupler_params.bin").read_bytes()
    assert "".join(f"{word:08x}" for word in struct.unpack_from("<2I", binary, 16)) == digest[:16]
    for name in ("decoupler_params.c", "decoupler_params.h", "decoupler_params.json"):
        assert digest in (tmp_path / "fw" / ("table" if name.endswith("json") else "") / name).read_text()
    assert [*record["files"], "manifest.json"] == sorted(
        (str(p.relative_to(tmp_path / "fw")) for p in (tmp_path / "fw").rglob("*") if p.is_file()),
        key=lambda n: (n == "manifest.json", n),
    )


# -- the box ---------------------------------------------------------------------------------------------


def test_the_box_is_what_the_log_recorded():
    d = made("stage31").decoupler
    span = calibration().log.span
    for column in ("z_m", "rx_rad", "ry_rad"):
        assert d.ends(column)[0] == pytest.approx(span[column][0], rel=1e-2)
        assert d.ends(column)[1] == pytest.approx(span[column][1], rel=1e-2)


# -- refusals --------------------------------------------------------------------------------------------


def stated(text):
    """An effect as `--effect` takes it."""
    return lambda model: adapted(model, (text,), {})


@pytest.mark.parametrize(
    ("name", "value"),
    [("height_quadratic", 1e-3), ("cross_axis_sensitivity", 1e-3), ("second_order_rotation", 1e-3),
     ("vertical_offset_coupling", 1e-3), ("reference_abbe_error", 1e-3), ("even_nonlinearity", 0.045)],
)  # fmt: skip
def test_every_effect_without_a_history_has_its_c(name, value):
    fit = with_effect(effects()[name], value)
    d = lower(fit, box_of(fit))
    inputs = inputs_of(d)
    found = steps_on_arrays(d)(inputs, d.constants)[0]
    assert np.abs(found - d.exact(inputs)).max() <= d.slack + 1e-16
    assert max(pose_bounds(d).error.values()) < 2e-7


def test_a_logged_temperature_is_one_more_input():
    fit = with_effect(stated("gain_temperature_drift:mean_degc=20"), 1e-3)
    code = generate(fit, ranges={"temperature_degc": (15.0, 30.0)})
    assert "DECOUPLER_STATUS_TEMPERATURE" in str(code.files["decoupler.h"])
    assert any(e.name == "gain_hall_a_temperature" and e.unit == "1/degC" for e in code.decoupler.table)


def test_undetermined_parameters_are_used_only_when_told_to():
    fit = calibration().changed(undetermined_by_log=("a_A", "b_A"))
    code = generate(fit, allow_undetermined=True)
    assert any("a_A, b_A" in note for note in code.notes)
    assert any("H1x, H1y" in note and "combinations" in note for note in code.notes)


# -- bounds ------------------------------------------------------------------------------------------------
