"""What other recordings would determine beside a log: against recordings that hold both, and by geometry."""

from dataclasses import replace

import numpy as np
import pytest
from twins import SIGMAS, TRUTH

from hallsym.families import build
from hallsym.families.halbach import half_turned
from hallsym.families.halbach.layout import arrays
from hallsym.inference import identify
from hallsym.simulation import Campaign, Run, paper_campaign, sine

GAP, WIDER = 4.2e-3, 5.2e-3


def sweeps(*gaps):
    """Sweeps of x, one at each gap."""
    return Campaign(8e-3, tuple(Run(2.0, {"z_m": gap}, {"x_m": sine(0.02, 1.1)}) for gap in gaps))


def judged(model, campaign, **values):
    noise = dict.fromkeys(model.channels, 1e-3) | dict.fromkeys(model.references, 1e-7)
    return identify(model, campaign, values={"a1": 0.62, **values}, noise=noise, profiles="none")


def test_another_gap_tells_a_harmonic_from_ends_as_well_as_a_recording_at_both_gaps():
    """A second harmonic of the magnets and sensors chosen anew over a finite array."""
    either = build("halbach", added=("forbidden_harmonics", "array_edges:reads=unknown"))
    found, both = (judged(either, sweeps(*gaps), a2=0.013) for gaps in ((GAP,), (GAP, WIDER)))
    assert (found.practical.rank, found.practical.of) == (6, 8)
    gap, turned = found.further
    assert (gap.rank, turned.rank) == (8, 6)
    assert set(gap.determined) == {"a2", "b2", "ends_cos", "ends_sin"}
    assert turned.determined == {}
    assert both.practical.rank == 8
    for name, std in gap.determined.items():
        assert std == pytest.approx(both[name].std, rel=1e-3)


def test_a_recording_that_adds_nothing_is_said_to():
    found = judged(build("halbach"), sweeps(GAP, WIDER))
    assert [(f.rank, f.determined) for f in found.further] == [(4, {}), (4, {})]


def test_a_turned_mover_tells_tilts_of_all_sensors_from_their_places():
    """Common place d, tilt t, phases f1 and f5 of the harmonics, zero x of the turned mover, k = 1:

    d + t + f1, d + t - f1 - x, 5 d + t + f5 and 5 d + t - f5 - 5 x are read. Turned, d = x / 2 is left free
    with f1 and f5, but t is not; by itself the log leaves d and t free. With the gauge d = 0, f1 follows.
    """
    model = build("halbach", added=("sensor_position_error", "sensor_tilt"))
    found = judged(model, sweeps(GAP, 4.8e-3, WIDER), a5=-6e-4, b1=0.1, b5=-8e-4)
    assert (found.practical.rank, found.practical.of) == (8, 10)
    gap, turned = found.further
    assert (gap.rank, turned.rank) == (8, 9)
    assert set(turned.determined) == {"b1", *(f"tiltx_{k}" for k in range(3))}


@pytest.mark.parametrize("name", ["halbach", "halbach_planar"])
def test_a_turned_mover_reads_as_one_turned_by_the_reference(name):
    """Turned in its mount, whose tilt is logged: half a turn of rz, or the board seen from its other side."""
    model = build(name)
    turned = half_turned(model)
    values = {"a1": 0.62, "a5": -2e-3} | ({"b1": 0.2, "b5": 1e-3} if name == "halbach" else {})
    pose = {"x_m": 3e-3, "y_m": -4e-3, "z_m": 6e-3, "rx_rad": 4e-3, "ry_rad": -5e-3, "rz_rad": 7e-3}
    places = np.array([[pose[c]] for c in model.pose])
    read = turned.readings(turned.vector(values), places)
    if name == "halbach":
        mirrored = np.array([[-3e-3], [6e-3]])
        plain = model.readings(model.vector(values), mirrored)
        np.testing.assert_allclose(read.ravel(), plain.ravel()[::-1], rtol=1e-12)
        return
    places[3:] = [[-4e-3], [5e-3], [7e-3 + np.pi]]  # Ry Rx Rz(pi) = Rz(pi) Ry(-) Rx(-)
    swapped = [s if not hasattr(s, "array") else _under(s, model.layout) for s in model.layout]
    board = model.family.maker(name)(tuple(swapped))
    plain = board.readings(board.vector(values), places)
    np.testing.assert_allclose(read.ravel(), plain.ravel(), rtol=1e-9, atol=1e-12)


def _under(sensor, layout):
    """The sensor with the array that stands over it when the mover has turned."""
    centre = np.array(arrays(layout)[sensor.array].centre)
    (name,) = (n for n, a in arrays(layout).items() if np.allclose(a.centre, -centre))
    return replace(sensor, array=name)


def test_a_family_that_offers_none_gets_none():
    found = identify(build("stage31"), paper_campaign(0.02), values=TRUTH, noise=SIGMAS, profiles="none")
    assert found.further == ()
    assert found.to_dict()["further"] == []
