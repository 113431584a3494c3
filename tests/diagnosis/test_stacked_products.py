"""Products of stacked rows are those of the columns written out, sample by sample; slopes are derivatives."""

import casadi as ca
import numpy as np
import pytest
from twins import simulated

from hallsym.diagnosis.normal_equations import Columns, normal_equations, slopes_of
from hallsym.diagnosis.setup import prepare
from hallsym.estimation.decoding import decoding_gain
from hallsym.families import build, effects
from hallsym.families.halbach.effects import magnets, mechanics, transducer
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import FAMILY, halbach
from hallsym.log import Batch
from hallsym.model import Model
from hallsym.model.arguments import example_facts
from hallsym.simulation import campaign_from


def whitened(work: Columns, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
    """All columns [zeros | parameters | candidates | residual], whitened, (c, K, samples)."""
    rows = work.rows(batch, weights)
    A = np.zeros((work.size, len(work.whiten), rows.shape[1]))
    A[work.column, work.channel] = rows[work.row]
    return work.whiten @ A


def test_products_are_those_of_columns_written_out():
    model = halbach(columns([(j - 4) * 0.01 for j in range(9)]))
    noise = dict.fromkeys(model.channels, 1e-3) | {"x_ref_m": 2e-6, "z_ref_m": 2e-6}
    campaign = campaign_from({**FAMILY.example.campaign, "step_s": 0.02}, "the example")
    log = simulated(model, FAMILY.example.values, campaign, noise)
    base = prepare(log, model, holdout=[1, 4]).base
    tried = {}
    for effect in (
        transducer.gain_mismatch,
        mechanics.time_skew,
        magnets.remanence_spread,
    ):  # of one channel, of all, of many
        wide = effect(model)
        tried[effect.name] = wide, [n for n in wide.names if n not in model.names]
    found = normal_equations(base, tried)
    work = Columns(base, tried)
    assert not model.offsets
    spread = np.linalg.inv(work.whiten)
    squares = np.zeros((2, work.size, work.size))
    for batch, weights in work.weighed():
        white = whitened(work, batch, weights)
        poses, state = batch.columns(model.references), batch.columns(model.state)
        D = decoding_gain(model, base.p, poses, state, base.weight) * base.pose_weights[:, None, None]
        pose = np.einsum("iks,kj,cjs->cis", D, spread, white, optimize=True)
        squares += [np.tensordot(A, A, axes=([1, 2], [1, 2])) for A in (white, pose)]
    for key, span in found.span.items():
        own = [*range(work.n), *(range(span.start, span.stop) if key else ()), work.size - 1]
        places = found.places[key] if key else slice(0, 0)
        for products, expected in zip((found.whitened, found.decoded), squares, strict=True):
            a = products.of(span if key else slice(0, 0), places).sum(axis=0)
            b = expected[np.ix_(own, own)]
            size = np.sqrt(np.outer(np.diag(b), np.diag(b)))
            assert np.all(np.abs(a - b) <= 1e-9 * size)


@pytest.mark.parametrize("beside", [(), ("gain_mismatch", "time_skew")])
@pytest.mark.parametrize(
    "name", ["stage31", "rotary", "halbach", pytest.param("halbach_planar", marks=pytest.mark.slow)]
)
def test_slopes_beside_a_model_are_derivatives_of_the_extended_one(
    name: str, beside: tuple[str, ...]
) -> None:
    known = effects(build(name).family)
    model = build(name, added=tuple(e for e in beside if e in known))
    tried: list[tuple[Model, list[str]]] = []
    for effect in known.values():
        free = effect.diagnosed and effect.name not in model.effects
        for variant in effect.variants(model, example_facts(model))[-1:] if free else ():
            wide = variant.make(model)
            tried.append((wide, [n for n in wide.names if n not in model.names]))
    rng = np.random.default_rng(0)
    for (wide, names), slope in zip(tried, slopes_of(model, tried), strict=True):
        s, index = wide.symbols, [wide.names.index(n) for n in names]
        full = ca.densify(ca.jacobian(s.full(s.reading), s.parameters[index]))
        inputs = [s.parameters, s.offsets, s.pose, s.state]
        p = wide.nominal + 1e-3 * rng.standard_normal(len(wide.names)) * ~np.isin(wide.names, names)
        at = p, *(1e-3 * rng.standard_normal(x.numel()) for x in inputs[1:])
        found, expected = (ca.Function("f", inputs, [x])(*at).full() for x in (ca.densify(slope), full))
        assert np.abs(expected).any(), names
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(expected).max())
