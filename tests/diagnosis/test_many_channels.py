"""Products of many channels made candidate by candidate are those made pair by pair."""

import sys

import numpy as np

import hallsym
from hallsym import Log, Noise, NoiseModel
from hallsym.diagnosis.setup import prepare
from hallsym.families.halbach.effects import magnets, mechanics, transducer
from hallsym.families.halbach.layout import columns
from hallsym.families.halbach.models import FAMILY, halbach
from hallsym.simulation import campaign_from

module = sys.modules["hallsym.diagnosis.normal_equations"]
"""Its name in the package is that of a function."""


def test_products_are_those_of_each_pair_of_channels(monkeypatch):
    model = halbach(columns([(j - 4) * 0.01 for j in range(9)]))
    noise = dict.fromkeys(model.channels, 1e-3) | {"x_ref_m": 2e-6, "z_ref_m": 2e-6}
    campaign = campaign_from({**FAMILY.example.campaign, "step_s": 0.02}, "the example")
    made = hallsym.simulate(model, FAMILY.example.values, campaign, NoiseModel(noise), seed=1)
    base = prepare(Log.from_arrays(made, Noise.given(noise, tuple(made))), model, holdout=[1, 4]).base
    tried = {}
    for effect in (
        transducer.gain_mismatch,
        mechanics.time_skew,
        magnets.remanence_spread,
    ):  # of one channel, of all, of many
        wide = effect(model)
        tried[effect.name] = wide, [n for n in wide.names if n not in model.names]
    found = module.normal_equations(base, tried)
    monkeypatch.setattr(module, "MANY", 99)
    pairs = module.normal_equations(base, tried)
    each = [(key, decoded) for key in found.span for decoded in (False, True)]
    for key, decoded in each:
        a, b = (t.of(key, decoded=decoded) for t in (found, pairs))
        size = np.sqrt(np.einsum("uii,ujj->uij", np.abs(b), np.abs(b)))
        assert np.all(np.abs(a - b) <= 1e-9 * size)
