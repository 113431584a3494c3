"""Every effect is complete: numbers, texts, parameters with a meaning, and nothing where they are 0."""

from dataclasses import replace

import casadi as ca
import numpy as np
import pytest

from hallsym.errors import InputError
from hallsym.families import FAMILIES, build, effects
from hallsym.families.faults import FAULTS, Injection, Recording
from hallsym.log import Meta
from hallsym.model import LINKS, Effect, Facts, Model, Parameter, effect, one_of
from hallsym.model.arguments import example_facts, from_log, searched

ANGLE = Meta(columns=("angle_rad", "angle_ref_rad"))
MODELS = [build("stage15"), build("stage31"), build("rotary_ideal"), build("rotary"),
          build("rotary_ideal", meta=ANGLE), build("rotary", meta=ANGLE),
          build("rings3"), build("halbach")]  # fmt: skip
CASES = [
    pytest.param(model, e, id=f"{model.name}-{len(model.channels)}-{e.name}")
    for model in MODELS
    for e in effects(model.family).values()
    if e.name not in model.effects
]


@pytest.mark.parametrize(("model", "known"), CASES)
def test_an_effect_says_all_about_itself(model: Model, known: Effect) -> None:
    assert known.link in LINKS
    assert known.meaning.endswith(".")
    assert known.separate
    assert all(number.meaning for number in known.numbers.values())
    variants = known.variants(model, example_facts(model))
    assert len({v.label for v in variants}) == len(variants)
    rng = np.random.default_rng(0)
    for variant in variants:
        wide = variant.make(model)
        # what is saved builds it again
        assert known.added(model, variant.text) is wide
        stated = {n: v for n, v in known.values(variant.text).items() if v is not None}
        assert known.text(**stated) == variant.text
        assert build(model.name, meta=layout_of(model), added=(variant.text,)).names == wide.names
        (new,) = [e for e in wide.effects if e not in model.effects]
        assert wide.texts[new] == variant.text
        # each parameter has a meaning and moves a reading
        old = {p.name for p in (*model.parameters, *model.offsets)}
        added = [p for p in (*wide.parameters, *wide.offsets) if p.name not in old]
        if not known.diagnosed:  # may add none, such as an exact rotation
            continue
        assert added
        for p in added:
            assert p.unit, p.name
            assert len(p.meaning) > 5, p.name
            assert "{" not in p.meaning, p.name
            assert -np.inf < p.lower <= p.nominal <= p.upper < np.inf
            assert p.lower < p.upper
        s = wide.symbols
        symbols = ca.vertcat(s.parameters, s.offsets)
        moves = np.array(ca.DM(ca.jacobian(s.full(s.reading), symbols).sparsity(), 1)).any(axis=0)
        names = [*wide.names, *(z.name for z in wide.offsets)]
        assert all(moves[names.index(p.name)] for p in added)
        # nothing at its nominal values, which are 0 but for widths and rails
        p, zeros, own = wide.nominal.copy(), np.zeros(len(wide.offsets)), len(model.names)
        p[:own] += 0.01 * rng.uniform(0.5, 1.0, own)
        pose = 1e-3 * rng.standard_normal(len(wide.pose))
        state = dict(zip(wide.state, 1e-3 * rng.standard_normal(len(wide.state)), strict=True))
        before = model.reading(p[:own], zeros[: len(model.offsets)], pose, [state[c] for c in model.state])
        after = wide.reading(p, zeros, pose, list(state.values()))
        moved = np.asarray(after - before).ravel()
        assert np.allclose(moved - 2 * np.pi * np.round(moved / (2 * np.pi)), 0, atol=1e-12)


@pytest.mark.parametrize("family", FAMILIES, ids=str)
def test_expressions_that_models_share_are_those_of_a_model_by_itself(family) -> None:
    """An effect goes on from the expressions of the model it is added to, also where it is the second."""
    rng = np.random.default_rng(0)
    model = family.maker(family.default)()
    _ = model.symbols
    variants = [v for e in family.catalogue for v in e.variants(model, example_facts(model))[-1:]]
    for k in rng.permutation(len(variants))[:6]:
        wide = variants[k].make(model)
        others = (wide, variants[k - 1].make(wide))
        for other in others:
            alone = replace(other, before=None)
            p = other.nominal + 1e-3 * rng.standard_normal(len(other.nominal))
            zeros, state = (1e-3 * rng.standard_normal(len(c)) for c in (other.offsets, other.state))
            pose = other.poses(1, rng).ravel() * (1.0 if other.typical else 1e-3)
            read = [np.asarray(m.reading(p, zeros, pose, state)).ravel() for m in (other, alone)]
            assert np.allclose(*read, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize(
    ("model", "text", "said"),
    [
        ("stage31", "hysteresis:half_with_m=1e-5", "did you mean 'half_width_m'"),
        ("stage31", "hysteresis:half_width_m=wide", "must be a number"),
        ("stage31", "hysteresis:half_width_m=-1", "must be a positive number"),
        ("stage31", "hysteresis:", "must be a name"),
        ("stage31", "hysteresis:half_width_m", "must be a name, or a name with its numbers"),
        ("stage31", "odd_nonlinearity:order=4", "must be one of 3, 5"),
        ("stage31", "gain_time_drift:settling_s=3,degree=2", "exclude each other"),
        ("stage31", "mount_slip:probe=Q,instant_s=3", "must be one of A, B, C"),
        ("stage31", "saturation:low_m=1/2,high_m=1/2", "3 numbers each"),
        ("stage31", "exact_rotation:order=3", "takes no numbers"),
        ("stage31", "clock_jiter", "Effect must be one of"),
        ("rotary", "cross_axis_sensitivity", "belongs to stage models; model rotary is of family rotary"),
        ("rotary", "mount_slip:probe=A,instant_s=2", "belongs to stage models"),
        ("rotary", "reference_pole_pair", "did you mean 'reference_pole_pairs'"),
        ("rotary", "reference_pole_pairs:periods=0.5", "periods per turn"),
        ("rotary", "hysteresis:half_width_m=1e-5", "did you mean 'half_width_rad'"),
        ("rotary", "uniform_stray_field:runs=1/2,source=speed", "exclude each other"),
        ("rotary", "uniform_stray_field:runs=1.5", "run numbers"),
        ("rotary", "saturation:low_v=1,high_v=1", "2 numbers each"),
        ("rotary", "saturation:level=0.9", "where only the angle is read"),
        ("rotary", "gain_time_drift:settling_s=0", "positive"),
        ("rotary", "eccentricity:form=chipped", "chip, both, curved"),
        ("stage31", "reference_pole_pairs", "belongs to rotary models; model stage31 is of family stage"),
    ],
)
def test_a_bad_text_is_one_clear_sentence(model: str, text: str, said: str) -> None:
    with pytest.raises(InputError, match=said) as refused:
        build(model, added=(text,))
    assert "\n" not in str(refused.value)


def layout_of(model: Model) -> Meta:
    return Meta(probes=[dict(p.entry) for p in model.layout])


def test_a_family_lists_each_effect_once() -> None:
    for family in FAMILIES:
        names = [e.name for e in family.effects]
        assert len(set(names)) == len(names)
        assert all(isinstance(e, Effect) for e in family.effects)
        assert not set(names) & set(FAULTS)


def test_a_fault_of_a_recording_has_a_remedy_and_is_injected() -> None:
    n = np.arange(400)
    angle = Recording(
        ("angle_rad",), np.sin(n / 50)[None], np.cos(n / 50)[None], n // 200, 1e-3, 1e-4, "rad", True
    )
    volts = Recording(
        ("v_sin_v", "v_cos_v"), np.array([np.sin(n / 50), np.cos(n / 50)]),
        np.array([np.cos(n / 50), -np.sin(n / 50)]), n // 200, 1e-3, 1e-4, "V", False,
    )  # fmt: skip
    for name, fault in FAULTS.items():
        assert name == fault.name
        assert fault.link in LINKS
        assert fault.remedy.endswith(".")
        with pytest.raises(InputError, match="fault of the recording") as refused:
            build("stage31", added=(name,))
        assert fault.remedy in str(refused.value)
        made = [fault.inject(r, lambda _: np.random.default_rng(1)) for r in (angle, volts)]
        assert any(isinstance(m, Injection) for m in made)
        for r, m in zip((angle, volts), made, strict=True):
            if isinstance(m, Injection):
                there = m.make(m.most, 0.0)
                assert there.shape == r.clean.shape
                assert np.abs(there - r.clean).max() > 0
            else:
                assert m


# -- what a signature declares -----------------------------------------------------------------------------


@effect(link="field", separate="several speeds")
def bent(
    model: Model,
    order: int = one_of({3: "cubic", 5: "quintic"}, "power"),
    width_m: float = searched((1.0, 2.0), "width", label=" of {:g}"),
    length_s: float = from_log(lambda facts: facts.duration_s, "length"),
) -> Model:
    """A bend.

    Of some order.
    """
    size = Parameter("size", 0.0, -1.0, 1.0, "1", f"size {order} {width_m} {length_s}")
    return model.with_step("field", lambda s, p: None, effect="bent", parameters=(size,))


def test_a_signature_is_what_is_tried_and_typed() -> None:
    model, facts = build("stage15"), Facts(60.0, ())
    tried = bent.variants(model, facts)
    assert [v.label for v in tried] == ["cubic of 1", "cubic of 2", "quintic of 1", "quintic of 2"]
    assert [v.tried for v in tried] == [2] * 4
    assert tried[0].text == "bent:width_m=1,length_s=60"
    assert tried[3].text == "bent:order=5,width_m=2,length_s=60"
    assert bent.lacking("bent:width_m=3") == ("length_s",)
    wide = bent(model, width_m=1.0000000001, length_s=2.0)
    assert wide.parameters[-1].meaning == "size 3 1.0 2.0"  # as a calibration would build it again
    assert wide.texts == {"bent": "bent:width_m=1,length_s=2"}
    assert (bent.meaning, bent.link) == ("A bend.", "field")


@pytest.mark.parametrize(
    ("numbers", "said"),
    [
        ({"width_m": 1.0}, "needs length_s"),
        ({"order": 4, "width_m": 1.0, "length_s": 1.0}, "must be one of 3, 5"),
        ({"width_m": -1.0, "length_s": 1.0}, "must be a positive number"),
        ({"with_m": 1.0}, "did you mean 'width_m'"),
    ],
)
def test_numbers_are_checked_from_python_as_on_the_command_line(numbers, said) -> None:
    with pytest.raises(InputError, match=said):
        bent(build("stage15"), **numbers)


def test_a_number_needs_a_default() -> None:
    with pytest.raises(InputError, match="Argument size of effect broken must have a default"):

        @effect(link="field")
        def broken(model: Model, size: float) -> Model:
            """No default."""
            return model

    with pytest.raises(InputError, match="Link of an effect must be one of clock, mechanics"):
        effect(link="magnet")


# -- explained ---------------------------------------------------------------------------------------------


def test_a_bend_with_each_height_has_readings_at_nominal_slopes_of_nil() -> None:
    model = build("stage31", added=("height_quadratic:form=tied",))
    pose, state = [1e-4, -1e-4, 1e-4], [2e-4, 1e-4, -1e-4]
    reading = model.reading(model.nominal, np.zeros(len(model.offsets)), pose, state)
    assert np.isfinite(np.asarray(reading)).all()
