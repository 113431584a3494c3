"""A model is immutable, orders its links as a signal meets them, and refuses what it does not know."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.families import build
from hallsym.families.stage.models import stage15, stage31, zero_deviation
from hallsym.model import LINKS, Parameter


def test_links_are_ordered_along_the_chain_whatever_the_order_of_adding():
    model = stage15()
    seen: list[str] = []

    def step(link):
        return lambda signals, parameters: seen.append(link)

    for link in reversed(LINKS):
        model = model.with_step(link, step(link), effect=f"watch_{link}")
    assert [LINKS.index(link) for link, _ in model.steps] == sorted(
        LINKS.index(link) for link, _ in model.steps
    )
    _ = model.reading
    assert seen == list(LINKS)


def test_a_step_ends_its_link():
    """A step added to the transducer sees the gain so far, and the read-out sees what it leaves."""
    model = stage15().with_step(
        "transducer",
        lambda s, p: s.__setitem__("gain", s["gain"] + p["more"]),
        effect="more",
        parameters=(Parameter("more", 0.25, 0.0, 1.0, "1"),),
    )
    p, q = model.nominal, [1e-4, 2e-4, 3e-5]
    base = np.asarray(stage15().reading(stage15().nominal, [], q, [0, 0, 0])).ravel()
    assert np.allclose(np.asarray(model.reading(p, [], q, [0, 0, 0])).ravel(), 1.25 * base, rtol=1e-15)


def test_adding_leaves_the_model_as_it_was():
    model = stage15()
    before = (model.names, model.steps, model.effects, model.offsets)
    zero_deviation(model).with_parameters({"H1x": {"nominal": 0.2}})
    assert (model.names, model.steps, model.effects, model.offsets) == before
    with pytest.raises(FrozenInstanceError):
        model.name = "other"


def test_unknown_link_and_taken_parameter_are_refused():
    with pytest.raises(InputError, match="must be one of clock, mechanics"):
        stage15().with_step("cable", None, effect="x")
    with pytest.raises(InputError, match="already part"):
        stage15().with_step("field", None, effect="x", parameters=(Parameter("H1x", 0, 0, 1, "m"),))


def test_bounds_and_nominal_values_change_by_name():
    model = stage31().with_parameters(
        {"H1x": {"nominal": 0.2, "lower": 0.1, "upper": 0.3}, "delta_A": {"upper": 5e-5}}
    )
    k = model.names.index("H1x")
    assert (model.nominal[k], model.bounds[0][k], model.bounds[1][k]) == (0.2, 0.1, 0.3)
    assert model.parameters[k].width == pytest.approx(0.2)
    assert model.offsets[0].upper == 5e-5
    with pytest.raises(InputError, match="lower <= upper"):
        stage31().with_parameters({"H1x": {"lower": 0.3, "upper": 0.2}})
    with pytest.raises(InputError, match="did you mean 'H1x'"):
        stage31().with_parameters({"H1xx": {"lower": 0.3}})


def test_crossed_bounds_of_a_zero_deviation_are_refused():
    with pytest.raises(InputError, match="delta_A"):
        stage31().with_parameters({"delta_A": {"lower": 1e-6, "upper": -1e-6}})


def test_derived_quantities_are_made_once_and_replaced_by_what_they_stand_for():
    def step(signals, parameters):
        one = signals.derive("twice x", 2 * signals["x_m"])
        assert signals.derive("twice x", 2 * signals["x_m"]) is one
        signals["displacement"] = signals["displacement"] + one

    model = stage15().with_step("mechanics", step, effect="twice")
    assert model.symbols.derived.numel() == 1
    reading = np.asarray(model.reading(model.nominal, [], [1e-4, 0, 0], [0, 0, 0])).ravel()
    assert np.allclose(reading, [2e-4, 2e-4, 3e-4], rtol=1e-15)


def test_overdetermined_decoding_is_weighted_least_squares():
    """Against numpy's least squares on readings that no pose explains."""
    from hallsym.families.stage.models import Probe

    layout = tuple(
        Probe(f"hall_{k}_m", position, senses)
        for k, position, senses in (
            ("a", (0.2, 0.4), (0.0, 1.0)),
            ("b", (-0.2, 0.4), (0.0, 1.0)),
            ("c", (0.2, -0.3), (1.0, 0.0)),
            ("d", (-0.1, 0.3), (0.6, 0.8)),
        )
    )
    model, rng = stage15(layout), np.random.default_rng(3)
    p = model.vector({"eta_A": 0.8, "eta_D": 0.9, "theta_C": 0.02})
    m, weight = rng.uniform(-3e-4, 3e-4, 4), np.array([1.0, 4.0, 0.25, 2.0])
    design = np.array([np.asarray(model.reading(p, [], e, [0, 0, 0])).ravel() for e in np.eye(3)]).T
    root = np.sqrt(weight)
    expected, *_ = np.linalg.lstsq(design * root[:, None], m * root, rcond=None)
    found = np.asarray(model.decoded(p, [], m, [0, 0, 0], weight)).ravel()
    assert np.allclose(
        found, expected, rtol=0, atol=1e-14 * np.abs(expected).max() * np.linalg.cond(design) ** 2
    )


@pytest.mark.parametrize(
    ("name", "turns"), [("stage31", 0), ("rotary", 3), ("halbach", 3), ("halbach_planar", 0)]
)
def test_arrays_are_decoded_as_single_samples_are_on_the_branch_asked_for(name, turns):
    """A planar mover that is rotated climbs from period to period, so only its own branch is exact."""
    model, rng = build(name), np.random.default_rng(1)
    pose, state = model.poses(3, rng), np.zeros((len(model.state), 3))
    size = 1.0 if model.typical else 1e-4
    offsets, weight = np.zeros(len(model.offsets)), np.ones(len(model.channels))
    reading = model.readings(model.nominal, size * pose, state, offsets)
    found = model.decode(model.nominal, offsets, reading, state, weight)
    single = [
        np.asarray(model.decoded(model.nominal, offsets, m, s, weight)).ravel()
        for m, s in zip(reading.T, state.T, strict=True)
    ]
    assert np.allclose(found, np.transpose(single), rtol=1e-12, atol=1e-15)
    shift = np.array([[turns * model.period.get(c, 0.0)] for c in model.pose])
    near = model.decode(model.nominal, offsets, reading, state, weight, found + shift)
    assert np.allclose(near, found + shift, rtol=1e-9, atol=1e-12)


def test_a_step_of_the_decoder_of_many_sensors_is_a_few_readings():
    """Of four steps: a gradient costs up to four readings (Griewank and Walther 2008), beside its own."""
    model = build("halbach_planar")
    assert model.decoded.n_instructions() < 4 * 5 * model.reading.n_instructions()
