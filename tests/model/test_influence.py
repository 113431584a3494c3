"""Slopes of the decoded pose are those of the decoder itself."""

import casadi as ca
import numpy as np
import pytest
from twins import combinations_of_effects, truth_of

from hallsym.families import build
from hallsym.families.stage import models as stage
from hallsym.model.influence import influence

CASES = combinations_of_effects()


def states(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(-4e-4, 4e-4, (3, n)), rng.uniform(-2e-4, 2e-4, (3, n))


@pytest.mark.parametrize(("name", "added"), CASES, ids=lambda v: "+".join(v) if isinstance(v, tuple) else v)
def test_slopes_are_the_jacobian_of_the_decoder(name, added):
    """CasADi differentiates the Newton steps of `decoded`; at a pose without residual both must agree."""
    model, rng = build(name, added=added), np.random.default_rng(1)
    p = model.vector(truth_of(model))
    zeros = rng.uniform(-5e-6, 5e-6, len(model.offsets))
    pose, state = states(4, rng)
    found = influence(model, p, zeros, pose, state)
    names = ["parameters", "offsets", "reading", "state", "weight"]
    symbols = [ca.SX.sym(n, model.decoded.size1_in(k)) for k, n in enumerate(names)]
    decoded = model.decoded(*symbols)
    for k in range(4):
        m = model.reading(p, zeros, pose[:, k], state[:, k])
        at = [p, zeros, m, state[:, k], np.ones(3)]
        got = [found.parameters, found.offsets, found.readings, found.state]
        for name_, symbol, slopes in zip(names[:4], symbols[:4], got, strict=True):
            if symbol.numel() == 0:
                continue
            slope = np.asarray(ca.Function("j", symbols, [ca.jacobian(decoded, symbol)])(*at))
            assert np.allclose(slopes[k], slope, rtol=1e-6, atol=1e-9 * np.abs(slope).max()), name_


def test_four_probes_weigh_by_variance():
    """The noisier of two probes at one place is believed less, in proportion to 1/variance."""
    layout = (
        stage.Probe("hall_a_m", (0.2, 0.4), (0.0, 1.0)),
        stage.Probe("hall_b_m", (-0.2, 0.4), (0.0, 1.0)),
        stage.Probe("hall_c_m", (0.2, 0.35), (1.0, 0.0)),
        stage.Probe("hall_d_m", (0.2, 0.35), (1.0, 0.0)),
    )
    model = stage.stage15(layout)
    found = influence(model, model.nominal, [], np.zeros((3, 1)), np.zeros((3, 1)), np.array([1.0, 1, 1, 3]))
    assert found.readings[0, 0, 3] == pytest.approx(3 * found.readings[0, 0, 2], rel=1e-12)
