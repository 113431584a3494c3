"""Rings of one jig: heads and drive are common, each ring has its table, and bad ones are named."""

from pathlib import Path

import jsonschema
import numpy as np
import pytest
from beside import REAL, needs
from rings import ONE, TURN, recorded, ring

from hallsym.cli import records
from hallsym.cli.main import main
from hallsym.errors import InputError
from hallsym.fleets import ring_fleet
from hallsym.fleets.row import AMISS, FAILED, GOOD
from hallsym.log import Log, Meta
from hallsym.report.views import page_of

NAMES = ("hall1_count", "hall2_count", "hall3_count")
RINGS = REAL / "rings-three-halls" / "rings.parquet"
PLACES = np.radians([0.0, 101.0, 262.0])


def log_of(x: np.ndarray, pairs: int = 4) -> Log:
    columns = dict(zip(NAMES, (2048 + 900 * x).T, strict=True))
    return Log.from_arrays(columns, meta=Meta(raw={"encoder": {"pole_pairs": pairs}}, columns=NAMES))


def rings_of(count: int) -> dict[str, Log]:
    """Rings of 4 pole pairs on one jig, whose drive starts from rest and has .1 deg at wave 10."""
    out = {}
    before = np.arange(240)[::-1] + 1.0
    ramp = 0.3 - TURN / 600 * (before - before**2 / 480)
    for k in range(count):
        own = ring(50 + k, pairs=4, places=PLACES, jitter=0.0)
        x = recorded(own, k, rows=600, turns=4.3, kinematic=0.1 * ONE, order=10)[1]
        out[f"ring{k}"] = log_of(np.concatenate([own.readings(ramp), x]))
    return out


@pytest.mark.slow
def test_a_fleet_finds_the_drive_and_names_what_is_wrong() -> None:
    logs = rings_of(11)
    x = np.stack([logs["ring8"].array(c) for c in NAMES], axis=1)
    dead = x.copy()
    dead[:, 1] = 2048
    still = x[:200].repeat(10, axis=0)
    last = x.copy()
    last[2260:] += 60 * np.sin(np.arange(len(x) - 2260) / 9.0)[:, None] * np.array([1, -1, 0])
    logs |= {"dead": log_of((dead - 2048) / 900), "still": log_of((still - 2048) / 900)}
    logs |= {"bent": log_of((last - 2048) / 900)}
    found = ring_fleet(logs, "rings3", workers=1)
    rows = {r["device"]: r for r in found.fleet.rows}
    assert rows["dead"]["verdict"] == FAILED
    assert "Hall 2 is dead" in rows["dead"]["reason"]
    assert rows["still"]["verdict"] == FAILED
    assert "turns" in rows["still"]["reason"]
    assert rows["bent"]["verdict"] == AMISS
    assert "does not repeat" in rows["bent"]["reason"]
    assert sum(r["verdict"] == GOOD for r in rows.values()) >= 10
    left = [r["left_rad"] for r in found.fleet.rows if "left_rad" in r]
    assert left == sorted(left)
    k = list(found.jig.orders).index(10)
    size = abs(found.jig.ripple[k])
    assert abs(size - 0.1 * ONE) < 4 * found.ripple_std[k] + 0.003 * ONE
    assert found.sentence.startswith("The drive has a ripple that all")
    truth = (PLACES[list(found.jig.heads[1:])] - PLACES[found.jig.heads[0]]) / 4
    assert np.abs(np.exp(1j * (found.jig.places - truth)) - 1).max() < 1e-3
    assert found.to_dict()["fleet"]["devices"] == 14
    assert page_of(found).count("<svg viewBox") > 10
    jsonschema.validate({"format": "hallsym fleet 1", **found.to_dict()}, records.schema("fleet"))


def test_too_few_rings_tell_no_jig() -> None:
    with pytest.raises(InputError, match="8 rings"):
        ring_fleet(rings_of(2), "rings3", workers=1)


def test_options_of_other_fleets_are_refused(capsys) -> None:
    data = str(Path(__file__).resolve().parents[2] / "data/ring")
    assert main(["fleet", data, "--reference", "none", "--diagnose"]) == 2
    assert main(["fleet", data, "--each-run"]) == 2
    assert "--reference" in capsys.readouterr().err


@pytest.mark.slow
@needs(RINGS)
def test_recorded_rings_learned_on_two_turns_are_right_on_the_third() -> None:
    """13 of 131 rings: median and 95 % of what is left, electrical deg (no reference: judged by a line)."""
    import pyarrow.parquet as pq

    table = pq.read_table(RINGS)
    ids = table["ring"].to_numpy()
    rings = np.unique(ids)[2::10]
    logs = {}
    for k in rings:
        x = np.stack([table[c].to_numpy()[ids == k][700:] for c in NAMES], axis=1).astype(float)
        logs[str(k)] = log_of((x - 2048) / 900, 25)
    found = ring_fleet(logs, "rings3", "constant-speed")
    left = np.degrees([r["left_rad"] for r in found.fleet.rows if r.get("left_rad")])
    assert np.median(left) < 0.46
    assert np.quantile(left, 0.9) < 1.1
    k = list(found.jig.orders).index(50)
    assert abs(np.degrees(abs(found.jig.ripple[k])) * 25 - 1.30) < 0.2
    assert np.max(np.abs(np.degrees(found.jig.places) + 7.96)) < 0.05
