"""Products of stacked rows are those of the columns written out, sample by sample."""

import numpy as np
from twins import simulated

from hallsym.diagnosis.normal_equations import Columns, normal_equations
from hallsym.diagnosis.setup import prepare
from hallsym.estimation.decoding import decoding_gain
from hallsym.families.halbach.effects import magnets, mechanics, transducer
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import FAMILY, halbach
from hallsym.log import Batch
from hallsym.simulation import campaign_from


def whitened(work: Columns, batch: Batch, weights: np.ndarray | None) -> np.ndarray:
    """All columns [zeros | parameters | candidates | residual], whitened, (c, K, samples)."""
    near, rows = work.columns(batch, weights)
    A = np.zeros((work.size, *near.shape[1:]))
    A[work.near] = near
    A[work.z + work.n + work.column, work.channel] = rows
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
        for decoded in (False, True):
            a, b = found.of(key or None, decoded=decoded).sum(axis=0), squares[int(decoded)][np.ix_(own, own)]
            size = np.sqrt(np.outer(np.diag(b), np.diag(b)))
            assert np.all(np.abs(a - b) <= 1e-9 * size)
