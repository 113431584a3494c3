"""A ring under several Halls: read as it is, fitted with a reference, decoded in C for any heads."""

import numpy as np
import pytest
from firmware import known
from rings import ONE, ring
from twins import with_arrays

import hallsym
from hallsym.codegen import generate
from hallsym.errors import InputError
from hallsym.families import build
from hallsym.log import Log, Meta

TURN = 2 * np.pi


def meta(pairs: int, *columns: str) -> Meta:
    return Meta(raw={"encoder": {"pole_pairs": pairs}}, columns=(*columns, "angle_ref_rad"))


def log_of(pairs: int, heads: int, unit: str = "count", turns: float = 2.0, samples: int = 3000, **field):
    """Return a log with a reference, and the truth."""
    rng = np.random.default_rng(pairs * 10 + heads)
    own = ring(3, pairs, places=TURN * np.arange(heads) / heads, **field)
    angle = np.linspace(0.0, turns * TURN, samples)
    scale = 900.0 if unit == "count" else 0.9
    x = scale * (own.readings(angle) + 1e-3 * rng.standard_normal((samples, heads)))
    names = [f"hall{k + 1}_{unit}" for k in range(heads)]
    columns = dict(zip(names, x.T, strict=True)) | {"angle_ref_rad": np.mod(angle, TURN)}
    noise = hallsym.Noise.given({**dict.fromkeys(names, scale * 1e-3), "angle_ref_rad": 1e-6}, tuple(columns))
    return Log.from_arrays(columns, noise=noise, meta=meta(pairs, *names)), own, scale


@pytest.mark.parametrize(
    ("pairs", "heads", "unit"), [(1, 3, "v"), (5, 3, "count"), (7, 2, "v"), (25, 4, "count")]
)
def test_offsets_amplitudes_and_places_come_back(pairs, heads, unit) -> None:
    log, own, scale = log_of(pairs, heads, unit, size=0.0)
    fit = hallsym.fit(log, "rings3", solver="direct")
    found = fit.model.named(fit.values)
    for k in range(heads):
        assert (
            abs(found[f"V{k + 1}"] - scale * own.offsets[k]) < 4 * fit.std[fit.model.names.index(f"V{k + 1}")]
        )
        assert abs(found[f"A{k + 1}"] / scale - own.gains[k]) < 1e-3
    for k in range(1, heads):
        away = found[f"place_{k + 1}"] - (own.places[k] - own.places[0])
        assert abs(away) * pairs < 5e-4
    assert fit.goodness is not None
    assert not fit.goodness.sentence
    assert fit.at_bound == ()  # .9 V of a range from 1e-6 to 1e6


def test_a_table_over_the_turn_is_read_at_the_bent_angle_and_fitted_with_a_reference() -> None:
    model = build("rings3", meta=meta(2, "hall1_v", "hall2_v", "hall3_v"), added=("turn_waves:count=3",))
    values = model.named(model.nominal) | {"t1c": 0.02, "t3s": -0.01, "V2": 0.3, "zero": 0.1}
    angle = np.linspace(0, TURN, 50)
    x = model.readings(model.vector(values), [angle])
    u = angle + 0.1
    u = u + 0.02 * np.cos(u) - 0.01 * np.sin(3 * u)
    expected = [k * 0.3 + np.cos(2 * (u + k2)) for k, k2 in ((0, 0.0), (1, TURN / 6), (0, TURN / 3))]
    assert np.abs(x - expected).max() < 1e-12
    pose = model.decode(model.vector(values), [], list(x), [], np.ones(3), angle[None] + 0.05)
    assert np.abs(pose - angle).max() < 1e-9


@pytest.mark.parametrize(
    ("stated", "columns", "said"),
    [
        ({"raw": {"encoder": {"pole_pairs": 2.5}}}, ("hall1_v", "hall2_v"), "pole_pairs"),
        ({"raw": {"encoder": {"poles": 2}}}, ("hall1_v", "hall2_v"), "poles"),
        ({"raw": {"encoder": 3}}, ("hall1_v", "hall2_v"), "a table"),
        ({"nominal": {"V3": 0.1}}, ("hall1_v", "hall2_v"), "parameter of rings3"),
        ({}, ("hall1_v",), "two Halls"),
    ],
)
def test_a_ring_that_cannot_be_is_refused(stated, columns, said) -> None:
    with pytest.raises(InputError, match=said):
        build("rings3", meta=Meta(**stated, columns=columns))


@pytest.mark.parametrize(("pairs", "heads", "arithmetic"), [(1, 3, "float"), (5, 3, "q31"), (4, 4, "q31")])
def test_c_of_several_heads_gives_the_angle_within_a_period(pairs, heads, arithmetic) -> None:
    log, _own, _scale = log_of(pairs, heads, size=0.01)
    effect = f"turn_waves:count=2,step={pairs}"
    fit = hallsym.fit(log, "rings3", solver="direct")
    bent = build("rings3", meta=log.meta, added=(effect,))
    values = bent.vector(
        fit.model.named(fit.values) | {f"t{pairs}c": 0.3 * ONE / pairs, f"t{2 * pairs}s": 0.2 * ONE}
    )
    fit = known(bent, values, noise=fit.noise, log=fit.log)
    made = generate(fit, arithmetic=arithmetic)
    angle = np.random.default_rng(0).uniform(-np.pi / pairs, np.pi / pairs, 500)
    x = bent.readings(values, [angle])
    assert np.abs(made.decoupler.difference(made.decoupler.exact(x), angle[None])).max() < 1e-9
    assert made.errors["angle_rad"] <= made.bounds.error["angle_rad"] < 1e-4 * TURN / pairs


def test_c_tells_that_one_of_three_heads_is_dead_and_a_warmer_magnet_is_none() -> None:
    log, own, scale = log_of(4, 3, size=1e-4)
    made, rng = generate(hallsym.fit(log, "rings3", solver="direct")), np.random.default_rng(5)
    angle = rng.uniform(-np.pi / 4, np.pi / 4, 4000)
    x = scale * (own.readings(angle).T + 1e-3 * rng.standard_normal((3, 4000)))

    def faults(readings):
        return made.backend.whole_step(readings.astype(np.float32))[1] & made.decoupler.fault_bit > 0

    offsets = scale * own.offsets[:, None]
    assert not faults(x).any()
    assert not faults(offsets + 0.97 * (x - offsets)).any()
    for k in range(3):
        dead = x.copy()
        dead[k] = 0.0
        assert faults(dead)[np.abs(x[k]) > 0.05 * scale].all()


def test_c_refuses_waves_that_one_moment_cannot_tell() -> None:
    log, *_ = log_of(5, 3, size=0.0)
    model = build("rings3", meta=log.meta, added=("turn_waves:count=2",))
    fit = hallsym.fit(log, model, solver="direct")
    with pytest.raises(InputError, match="from one period to the next"):
        generate(with_arrays(fit, values=fit.values + 1e-3))
