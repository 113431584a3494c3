"""Slopes of the decoded pose are those of the decoder itself."""

import casadi as ca
import numpy as np
import pytest
from twins import combinations_of_effects, truth_of

from hallsym.families import build
from hallsym.families.stage import models as stage
from hallsym.model.influence import influence

FOUR = (*stage.paper_layout(), stage.Probe("hall_d_m", (-0.1, 0.3), (0.6, 0.8)))
CASES = [*((build(name, added=added), name + "+".join(added)) for name, added in combinations_of_effects()),
         (stage.stage31(FOUR), "four probes")]  # fmt: skip


def states(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    return rng.uniform(-4e-4, 4e-4, (3, n)), rng.uniform(-2e-4, 2e-4, (3, n))


@pytest.mark.parametrize("model", [model for model, _ in CASES], ids=[name for _, name in CASES])
def test_slopes_are_the_jacobian_of_the_decoder(model):
    """CasADi differentiates the Newton steps of `decoded`; at a pose without residual both must agree."""
    rng, weight = np.random.default_rng(1), np.array([1.0, 3.0, 2.0, 5.0])[: len(model.channels)]
    p = model.vector(truth_of(model))
    zeros = rng.uniform(-5e-6, 5e-6, len(model.offsets))
    pose, state = states(4, rng)
    found = influence(model, p, zeros, pose, state, weight)
    names = ["parameters", "offsets", "reading", "state", "weight"]
    symbols = [ca.SX.sym(n, model.decoded.size1_in(k)) for k, n in enumerate(names)]
    decoded = model.decoded(*symbols)
    for k in range(4):
        m = model.reading(p, zeros, pose[:, k], state[:, k])
        at = [p, zeros, m, state[:, k], weight]
        got = [found.parameters, found.offsets, found.readings, found.state]
        for name_, symbol, slopes in zip(names[:4], symbols[:4], got, strict=True):
            if symbol.numel() == 0:
                continue
            slope = np.asarray(ca.Function("j", symbols, [ca.jacobian(decoded, symbol)])(*at))
            assert np.allclose(slopes[k], slope, rtol=1e-6, atol=1e-9 * np.abs(slope).max()), name_
