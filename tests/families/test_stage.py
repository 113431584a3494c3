"""The stage's physics, by equivalences that share no code with it.

Equivalences: the article's PM and phi typed in numpy; decoding inverts reading; rotated machines read the
same; finite rotation is that of its matrix; tied coupling is the free one of a rigid stage; lever arms are
all that H does; the article's own Table 2.
Tolerances count roundings (EPS, half a unit in the last place each) times the size of the terms.
"""

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from twins import EPS, TRUTH, inside, phi, phi_size, pm

from hallsym.errors import InputError
from hallsym.estimation.decoding import error_tables
from hallsym.families import build
from hallsym.families.stage.models import (
    Probe,
    exact_rotation,
    paper_layout,
    stage15,
    stage30,
    stage31,
    stage31_tied,
    tied_vertical_coupling,
    vertical_coupling,
)
from hallsym.log import Log, Meta
from hallsym.simulation import Campaign, paper_campaign, simulate, table8_noise

ROUNDINGS = 16 * EPS
"""Some ten operations lie between data and reading, in each of the two computations."""

unit = st.floats(-1.0, 1.0)
poses = st.tuples(unit, unit, unit).map(lambda q: np.array(q) * [2e-3, 2e-3, 1e-3])
states = st.tuples(unit, unit, unit).map(lambda s: np.array(s) * [3e-4, 5e-4, 5e-4])
deltas = st.tuples(unit, unit, unit).map(lambda d: np.array(d) * 1e-5)
seeds = st.integers(0, 2**32 - 1)
NONE = np.zeros(0)


def numbers(function: ca.Function, *arguments) -> np.ndarray:
    return np.asarray(function(*arguments)).ravel()


def zeros(model, d: np.ndarray) -> np.ndarray:
    return d if model.offsets else NONE


# -- the article's equations -----------------------------------------------------------------------------


@settings(max_examples=25)
@given(poses, states, deltas, seeds)
@pytest.mark.parametrize("make", [stage15, stage30, stage31])
def test_reading_is_the_articles_equation(make, q, s, delta, seed):
    model = make()
    p = inside(model, np.random.default_rng(seed))
    v = model.named(p)
    d = delta / phi(v, s * 0.0) if model.offsets else np.zeros(3)
    expected = phi(v, s) * (pm(v) @ q + d)
    size = phi_size(v, s) * (np.abs(pm(v)) @ np.abs(q) + np.abs(d))
    assert np.all(np.abs(numbers(model.reading, p, zeros(model, d), q, s) - expected) <= ROUNDINGS * size)
    assert np.all(np.abs(numbers(model.gain, p, s) - phi(v, s)) <= ROUNDINGS * phi_size(v, s))


# -- any layout ------------------------------------------------------------------------------------------


@st.composite
def layouts(draw, sizes=(3, 4, 6)):
    """Probes anywhere on a 0.8 m stage that sense in any direction, geometry that tells x, y, Rz apart."""
    n = draw(st.sampled_from(sizes))
    rng = np.random.default_rng(draw(seeds))
    position, angle = rng.uniform(-0.4, 0.4, (n, 2)), rng.uniform(-np.pi, np.pi, n)
    senses = np.array([np.cos(angle), np.sin(angle)]).T
    matrix = np.column_stack([senses, (position[:, 0] * senses[:, 1] - position[:, 1] * senses[:, 0]) / 0.3])
    assume(np.linalg.cond(matrix) < 30)
    return tuple(
        Probe(f"hall_{'abcdef'[k]}_m", tuple(position[k].tolist()), tuple(senses[k].tolist()))
        for k in range(n)
    )


@settings(max_examples=12)
@given(layouts(), poses, states, seeds)
@pytest.mark.parametrize("effects", [(), ("exact_rotation",)])
@pytest.mark.parametrize("make", [stage15, stage30, stage31, stage31_tied])
def test_decoding_inverts_reading(make, effects, layout, q, s, seed):
    """Normal equations square the condition number (30 at nominal values; below 60 with misalignment)."""
    model = make(layout)
    for _ in effects:
        model = exact_rotation(model)
    rng = np.random.default_rng(seed)
    p = model.vector(
        {n: v for n, v in model.named(inside(model, rng)).items() if n.startswith(("eta", "x0", "y0", "H"))}
        | {n: rng.uniform(-0.03, 0.03) for n in model.names if n.startswith("theta")}
        | {n: rng.uniform(-200, 200) for n in model.names if n.split("_")[0] in ("a", "b", "c")}
    )
    p = np.where([n.startswith("H") for n in model.names], model.nominal, p)
    d = rng.uniform(-1e-5, 1e-5, len(model.offsets))
    reading = numbers(model.reading, p, d, q, s)
    back = numbers(model.decoded, p, d, reading, s, rng.uniform(0.5, 2.0, len(layout)))
    scale = np.array([1.0, 1.0, 1 / 0.3]) * (np.linalg.norm(q * [1, 1, 0.3]) + 1e-5)
    assert np.all(np.abs(back - q) <= 60**2 * 4 * ROUNDINGS * scale)


@settings(max_examples=12)
@given(layouts(), poses, states, st.floats(-3.0, 3.0), seeds)
@pytest.mark.parametrize("exact", [False, True])
def test_turned_machine_reads_the_same(exact, layout, q, s, turn, seed):
    """Turning stage, probes, displacement and tilt together changes no reading."""
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    turned = tuple(Probe(p.channel, tuple(R @ p.position), tuple(R @ p.senses)) for p in layout)
    rng = np.random.default_rng(seed)
    make = (lambda x: exact_rotation(stage31_tied(x))) if exact else stage31_tied
    one, two = make(layout), make(turned)
    v = {n: x for n, x in one.named(inside(one, rng)).items() if n.startswith(("theta", "eta"))}
    v |= {n: rng.uniform(-200, 200) for n in one.names if n.startswith("a_")}
    point = rng.uniform(-0.3, 0.3, 2)
    read = numbers(
        one.reading, one.vector(v | dict(zip(("x0", "y0"), point, strict=True))), np.zeros(len(layout)), q, s
    )
    p = two.vector(v | dict(zip(("x0", "y0"), R @ point, strict=True)))
    other = numbers(two.reading, p, np.zeros(len(layout)), [*(R @ q[:2]), q[2]], [s[0], *(R @ s[1:])])
    assert np.all(np.abs(read - other) <= 4 * ROUNDINGS * np.abs(q).sum() + 1e-22)


# -- effects ---------------------------------------------------------------------------------------------


@settings(max_examples=12)
@given(layouts(), st.tuples(unit, unit, st.floats(-3.0, 3.0)), seeds)
def test_exact_rotation_is_the_rotation_matrix(layout, q, seed):
    """A probe at p moves by R(Rz) (p + (x, y)) - p, whatever the angle."""
    model = exact_rotation(stage15(layout))
    v = model.named(inside(model, np.random.default_rng(seed)))
    q = np.array(q)
    rz = q[2]
    R = np.array([[np.cos(rz), -np.sin(rz)], [np.sin(rz), np.cos(rz)]])
    expected = []
    for k, probe in enumerate(layout, start=1):
        sign = np.where(np.array(probe.position) < 0, -1.0, 1.0)
        p = sign * [v[f"H{k}x"], v[f"H{k}y"]]
        angle = np.arctan2(probe.senses[1], probe.senses[0]) + v[f"theta_{probe.label}"]
        moved = R @ (p + q[:2]) - p
        expected.append(v[f"eta_{probe.label}"] * ([np.cos(angle), np.sin(angle)] @ moved))
    found = numbers(model.reading, model.vector(v), NONE, q, np.zeros(3))
    assert np.allclose(found, expected, rtol=0, atol=8 * ROUNDINGS)  # all terms are of order 1 m


@settings(max_examples=12)
@given(layouts(), poses, states, seeds)
def test_tied_coupling_is_the_free_one_of_a_rigid_stage(layout, q, s, seed):
    tied, free = tied_vertical_coupling(stage15(layout)), vertical_coupling(stage15(layout))
    v = tied.named(inside(tied, np.random.default_rng(seed)))
    w = {n: x for n, x in v.items() if n in free.names}
    for k, probe in enumerate(layout, start=1):
        sx, sy = (-1.0 if value < 0 else 1.0 for value in probe.position)
        a = v[f"a_{probe.label}"]
        w[f"b_{probe.label}"] = a * (sy * v[f"H{k}y"] - v["y0"])
        w[f"c_{probe.label}"] = -a * (sx * v[f"H{k}x"] - v["x0"])
    one = numbers(tied.reading, tied.vector(v), NONE, q, s)
    two = numbers(free.reading, free.vector(w), NONE, q, s)
    size = 1.05 + 5000 * (np.abs(s) @ [1.0, 1.2, 1.2])
    assert np.all(np.abs(one - two) <= ROUNDINGS * size * (np.abs(q) @ [1.0, 1.0, 1.0]))


def test_lever_arms_are_the_third_column_of_pm_and_read_so():
    model = stage31()
    assert np.allclose(numbers(model.combined, model.vector(TRUTH)), pm(TRUTH)[:, 2], rtol=0, atol=4 * EPS)
    for combination, value in zip(model.combinations, pm(TRUTH)[:, 2], strict=True):
        names = {**TRUTH, "sin": np.sin, "cos": np.cos}
        assert eval(combination.expression, {"__builtins__": {}}, names) == pytest.approx(value, rel=4 * EPS)


# -- what is refused -------------------------------------------------------------------------------------

A, B, C = paper_layout()


@pytest.mark.parametrize(
    ("layout", "said"),
    [
        ((A, B), "at least 3 probes"),
        ((A, B, Probe("hall_a_um", (0.1, 0.1), (1.0, 0.0))), "different letters"),
        ((A, B, Probe("hall_c_m", (0.2, 0.3), (1.0, 0.1))), "unit vector"),
        ((A, B, Probe("hall_c_m", (0.2, 0.3), (float("nan"), 0.0))), "finite"),
        ((A, B, Probe("hall_c_m", (float("nan"), 0.36), (1.0, 0.0))), "finite"),
        ((A, B, Probe("hall_c_m", (0.0, -0.3), (0.0, 1.0))), "must determine"),  # nothing senses X
        (
            tuple(Probe(f"hall_{k}_m", (0.1 * n, 0.2 * n), (0.6, 0.8)) for n, k in enumerate("abc")),
            "must determine",
        ),
        (  # all lines of sight meet in one point: a rotation about it is not seen
            tuple(
                Probe(f"hall_{k}_m", *at)
                for k, *at in (
                    ("a", (0.2, 0.0), (1.0, 0.0)),
                    ("b", (0.0, 0.2), (0.0, 1.0)),
                    ("c", (-0.2, 0.0), (1.0, 0.0)),
                )
            ),
            "must determine",
        ),
    ],
)
def test_impossible_layouts_are_refused(layout, said):
    with pytest.raises(InputError, match=said):
        stage15(layout)


def test_two_forms_of_one_coupling_do_not_go_together():
    with pytest.raises(InputError, match="tied_vertical_coupling"):
        tied_vertical_coupling(stage31())


# -- a machine described by its log ----------------------------------------------------------------------

ENTRIES = [
    {"channel": p.channel, "position_m": list(p.position), "senses": list(p.senses)} for p in paper_layout()
]


def test_meta_gives_layout_and_nominal_values():
    meta = Meta(probes=ENTRIES, nominal={"H1x": 0.2, "eta": [0.9, 0.7, 0.8], "theta_rad": [0.01, 0.02, 0.03]})
    model = build("stage31", meta=meta)
    assert model.layout == paper_layout()
    expected = stage31().vector(
        {"H1x": 0.2, "eta_A": 0.9, "eta_B": 0.7, "eta_C": 0.8}
        | {"theta_A": 0.01, "theta_B": 0.02, "theta_C": 0.03}
    )
    assert np.array_equal(model.nominal, expected)


@pytest.mark.parametrize(
    "meta",
    [
        Meta(nominal={"eta": [1.0, 1.0]}),
        Meta(nominal={"eta": 1.0}),
        Meta(nominal={"H1x": "wide"}),
        Meta(nominal={"H1x": [0.2]}),
        Meta(nominal={"theta_rad": [0.0, 0.0, "none"]}),
        Meta(nominal={"H1q": 0.2}),
        Meta(probes=[{"channel": "hall_a_m"}, *ENTRIES[1:]]),
        Meta(probes=[{**ENTRIES[0], "position_m": [0.1]}, *ENTRIES[1:]]),
        Meta(probes=["hall_a_m", *ENTRIES[1:]]),
    ],
)
def test_meta_that_cannot_be_is_refused(meta):
    with pytest.raises(InputError):
        build("stage31", meta=meta)


# -- the article's Table 2 -------------------------------------------------------------------------------


def test_designed_values_leave_the_articles_errors_at_both_ends_of_z():
    """With Table 8's noise: RMSE 35, 45, 87 and peak 82, 130, 224 (um, um, urad)."""
    ends = tuple(run for run in paper_campaign().runs if abs(run.setting["z_m"]) == 250e-6)
    log = Log.from_arrays(simulate(stage31(), TRUTH, Campaign(2e-3, ends), table8_noise(stage31()), seed=0))
    model = stage15()
    (table,) = error_tables(log, model, [(model.nominal, {})], np.ones(3))
    found = {row: list(entry.values()) for row, entry in table.over().items()}
    assert np.allclose(found["rmse"], [35e-6, 45e-6, 87e-6], rtol=0.03)
    assert np.allclose(found["peak"], [82e-6, 130e-6, 224e-6], rtol=0.03)


@pytest.mark.parametrize(
    ("name", "response"),
    [("time_skew", lambda x: np.exp(-1j * x)), ("first_order_lag", lambda x: 1 / (1 + 1j * x))],
)
def test_late_readings_of_a_fast_tone_have_the_exact_phase_and_size(name, response):
    """At tau times angular frequency of .3 the series of the low-pass is off by .3^7 of the stroke."""
    share, rate = 0.3, 2 * np.pi * 20
    late, model = (build("stage30", added=added) for added in ((name,), ()))
    tone = 1e-4 * np.exp(1j * np.linspace(0, 2 * np.pi, 50))

    def read(wide, values, moved):
        rates = [((1j * rate) ** n * tone).real for n in range(1, 7)]
        known = {f"d{n}_x_ref_m": v for n, v in enumerate(rates, start=1)}
        state = [known.get(c, 0 * tone.real) for c in wide.state]
        still = 0 * tone.real
        return wide.readings(values, [moved.real, still, still], state)

    values = late.vector({f"tau_{name}": share / rate})
    exact = read(model, model.nominal, response(share) * tone)
    assert np.abs(read(late, values, tone) - exact).max() < 1.1 * share**7 * np.abs(exact).max()
