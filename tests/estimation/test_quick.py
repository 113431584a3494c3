"""A quick fit: the numbers of a fit, one pass over a log in order, and a fit in full of any other."""

import numpy as np
import pytest
from twins import record, with_noise

from hallsym.estimation import fit
from hallsym.estimation.decoding import error_tables


def test_a_log_in_order_is_fitted_without_error_tables():
    log = with_noise(record(seed=1, samples=60))
    whole, quick = (fit(log, "stage31", solver="direct", quick=q) for q in (False, True))
    assert quick.errors is None
    assert quick.error_rows == {}
    assert "designed" not in vars(whole.errors)  # errors of nominal parameters are tabulated when asked for
    (nominal,) = error_tables(log, whole.model, [(whole.model.nominal, {})], np.ones(3))
    assert whole.to_dict()["errors"]["designed"] == nominal.over()
    # Newton's method ends where it promises less than 1e-12 of the cost, 1e4: a step of 1e-4 sigma at most
    assert np.abs((quick.values - whole.values) / whole.std)[whole.determined].max() < 1e-4
    assert quick.std == pytest.approx(whole.std, rel=1e-5, nan_ok=True)
    assert quick.goodness.sentence is None
    assert "stage31" in quick.summary()


def test_spikes_and_what_the_model_leaves_are_looked_at_in_full():
    columns = record(seed=2, samples=60)
    spiky = {n: v.copy() for n, v in columns.items()}
    spiky["hall_a_m"][[200, 900, 2500]] += 2e-4
    bent = {**columns, "hall_a_m": columns["hall_a_m"] + 0.3 * columns["x_ref_m"] ** 2 / 1e-3}
    for log in (with_noise(spiky), with_noise(bent)):
        whole, quick = (fit(log, "stage31", solver="direct", quick=q, accept=["all"]) for q in (False, True))
        assert quick.errors is not None
        assert np.abs((quick.values - whole.values) / whole.std)[whole.determined].max() < 1e-4
        assert quick.notes == whole.notes
