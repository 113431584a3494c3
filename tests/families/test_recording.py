"""Mistakes of a recording: a text states each, and undoing one that was made gives the samples back.

Each mistake is made in numpy here, with no code of the package.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from twins import record, with_noise

from hallsym.errors import InputError
from hallsym.estimation import evaluate, fit, load_fit
from hallsym.estimation.calibration import Claim
from hallsym.families.recording import (
    MISTAKES,
    Correction,
    assignment_of,
    corrected,
    read_correction,
    said,
)
from hallsym.log import Log, Noise, read_log, write_log

A, B, X = "hall_a_m", "hall_b_m", "x_ref_m"
N = 200


@pytest.fixture(scope="module")
def right():
    """Three runs of smooth columns."""
    rng = np.random.default_rng(29)
    columns = {"run": np.repeat([2, 3, 7], N), "t_s": np.tile(1e-3 * np.arange(N), 3)}
    return columns | {c: rng.standard_normal(3 * N).cumsum() for c in (A, B, X)}


def run_of(columns, run):
    return columns["run"] == run


# -- texts -------------------------------------------------------------------------------------------------

NUMBER = st.floats(1e-6, 1e6).map(lambda v: float(f"{v:.6g}"))
RUNS = st.sets(st.integers(0, 99), max_size=6).map(lambda runs: tuple(sorted(runs)))


@st.composite
def stated(draw):
    known = MISTAKES[draw(st.sampled_from(sorted(MISTAKES)))]
    runs, columns = draw(RUNS), draw(st.sampled_from([(A,), (A, B), (A, B, X)]))
    if known.whole_run:
        return Correction(known.name, (), (), runs or (4,))
    many = len(known.numbers) - (known.since and draw(st.booleans()))
    whole = {"SAMPLES", "SAMPLE", "START", "STOP"}
    numbers = tuple(
        float(draw(st.integers(1, 500))) if name in whole else draw(NUMBER) for name in known.numbers[:many]
    )
    return Correction(known.name, (A, B) if known.pair else columns, numbers, runs)


@given(stated())
def test_a_text_comes_back(one):
    assert read_correction(one.text) == one


def test_units_stand_in_texts():
    one = read_correction("scale rx_rad deg in 3,5,7-9")
    assert one == Correction("scale", ("rx_rad",), (np.pi / 180,), (3, 5, 7, 8, 9), "deg")
    assert one.text == "scale rx_rad deg in 3,5,7-9"
    assert assignment_of([read_correction("sign hall_a_m in 3")], (A, B)) is None
    assert read_correction("scale x_ref_m inch in 3") == Correction("scale", (X,), (0.0254,), (3,), "inch")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "must begin with one of sign, scale, "),
        ("sing x_ref_m", "did you mean 'sign'"),
        ("sign", r"must read 'sign COLUMN\[,COLUMN\] \[in RUNS\]'"),
        ("exchange x_ref_m", "must read 'exchange COLUMN COLUMN"),
        ("delay x_ref_m", "must read 'delay .* SAMPLES"),
        ("delay x_ref_m 1.5", "'1.5' is no such number"),
        ("scale x_ref_m 0", "'0' is no such number"),
        ("scale x_ref_m deg", "must name a unit of x_ref_m; deg is none"),
        ("clipped x_ref_m 1 2 3", "must read 'clipped"),
        ("zero_moved x_ref_m nan", "'nan' is no such number"),
        ("copied_run", "must read 'copied_run in RUNS'"),
        ("sign x_ref_m in x-3", "such as 2,7,12 or 40-45"),
    ],
)
def test_a_text_of_another_form_is_one_sentence(text, says):
    with pytest.raises(InputError, match=says) as caught:
        read_correction(text)
    assert str(caught.value).count(". ") == 0


def test_columns_and_runs_that_a_log_does_not_have(right):
    log = Log.from_arrays(right)
    with pytest.raises(InputError, match="hall_x_m"):
        corrected(log, [read_correction("sign hall_x_m")])
    with pytest.raises(InputError, match=r"names run 5, which .* does not have"):
        corrected(log, [read_correction("sign hall_a_m in 3,5")])


# -- what was made is undone -------------------------------------------------------------------------------


WRONG = {
    "sign hall_a_m,x_ref_m": lambda d: {A: -d[A], X: -d[X]},
    "sign hall_a_m in 3": lambda d: {A: np.where(run_of(d, 3), -d[A], d[A])},
    "scale x_ref_m mm": lambda d: {X: 1e3 * d[X]},
    "scale x_ref_m 0.1 in 2,7": lambda d: {X: np.where(run_of(d, 3), 1, 10) * d[X]},
    "exchange hall_a_m x_ref_m": lambda d: {A: d[X], X: d[A]},
    "zero_moved hall_b_m 0.5 from 50": lambda d: {B: d[B] + 0.5 * (np.tile(np.arange(N), 3) >= 50)},
    "zero_moved hall_b_m -0.5 in 7": lambda d: {B: d[B] - 0.5 * run_of(d, 7)},
    "gain_step hall_b_m 1.25 in 2": lambda d: {B: d[B] * np.where(run_of(d, 2), 1.25, 1.0)},
    "gain_step hall_b_m 1.25 from 9": lambda d: {B: d[B] * np.where(np.tile(np.arange(N), 3) >= 9, 1.25, 1)},
    "delay hall_a_m 3": lambda d: {A: np.roll(d[A], 3)},
    "delay hall_a_m,hall_b_m -2 in 7": lambda d: {
        c: np.where(run_of(d, 7), np.roll(d[c], -2), d[c]) for c in (A, B)
    },
    "clipped x_ref_m -2 2": lambda d: {X: np.clip(d[X], -2, 2)},
    "clipped x_ref_m -inf 1 in 3": lambda d: {X: np.where(run_of(d, 3), np.minimum(d[X], 1), d[X])},
    "stuck hall_a_m 40 60 in 2": lambda d: {A: np.r_[d[A][:40], np.full(20, d[A][40]), d[A][60:]]},
    "stuck hall_a_m": lambda d: {A: d[A][np.arange(3 * N) - 20 * (np.tile(np.arange(N), 3) // 20 == 3)]},
    "coarse_steps hall_a_m 0.25": lambda d: {},
    "copied_run in 7": lambda d: {c: np.where(run_of(d, 7), np.roll(d[c], N), d[c]) for c in (A, B, X)},
    "other_device in 3,7": lambda d: {A: np.where(run_of(d, 2), 1.0, 0.7) * d[A]},
}
LOST = {
    "delay hall_a_m 3": lambda d: np.tile(np.arange(N), 3) >= N - 3,
    "delay hall_a_m,hall_b_m -2 in 7": lambda d: run_of(d, 7) & (np.tile(np.arange(N), 3) < 2),
    "clipped x_ref_m -2 2": lambda d: np.abs(d[X]) >= 2,
    "clipped x_ref_m -inf 1 in 3": lambda d: run_of(d, 3) & (d[X] >= 1),
    "stuck hall_a_m 40 60 in 2": lambda d: np.arange(3 * N) // 20 == 2,
    "stuck hall_a_m": lambda d: np.tile(np.arange(N), 3) // 20 == 3,
    "copied_run in 7": lambda d: run_of(d, 7),
    "other_device in 3,7": lambda d: ~run_of(d, 2),
}
"""Samples that cannot be given back, and are left out; of all others every column is as it was."""


@pytest.mark.parametrize("text", WRONG)
def test_undoing_a_mistake_gives_the_samples_back(right, text):
    log = corrected(Log.from_arrays(right | WRONG[text](right)), [read_correction(text)])
    stay = ~LOST.get(text, lambda d: np.zeros(3 * N, dtype=bool))(right)
    assert log.rows == stay.sum()
    for c in right:
        assert log.array(c) == pytest.approx(right[c][stay], rel=1e-12, abs=1e-12), c


def test_a_rail_as_a_text_prints_it_takes_the_samples_at_it():
    """A text has nine digits; the samples at the rail have all of theirs."""
    low, high = -2.71828182845904e-4, 3.14159265358979e-4
    x = np.clip(np.linspace(-4e-4, 4e-4, 101), low, high)
    rail = Correction("clipped", (X,), (low, high))
    log = corrected(Log.from_arrays({"run": np.zeros(101, int), X: x}), [read_correction(rail.text)])
    assert log.rows == np.sum((x > low) & (x < high))


@pytest.mark.parametrize("samples", [2, 3, 4, 5, 8, 9, 16])
def test_a_mean_is_undone_where_its_window_is_whole(samples):
    """Of motion that half a wave of which is longer than the mean, to 1.3e-3 of its amplitude."""
    at = np.arange(600)
    smooth = np.sin(2 * at / samples) + 0.5 * np.cos(0.7 * at / samples + 1)
    weights = np.r_[0.5, np.ones(samples - 1), 0.5] if samples % 2 == 0 else np.ones(samples)
    mean = np.convolve(smooth, weights / samples, "same")
    log = Log.from_arrays({"run": np.zeros(600, int), A: mean, X: smooth, "t_s": at * 1e-3})
    log = corrected(log, [read_correction(f"averaged hall_a_m {samples}")])
    assert log.rows == 600 - 2 * (2 * max(samples // 2, 1) + samples // 2)
    assert np.abs(log.array(A) - log.array(X)).max() < 2e-3


def test_noise_of_a_mean_that_is_undone_is_known():
    rng = np.random.default_rng(5)
    for samples in (3, 4, 9):
        weights = np.r_[0.5, np.ones(samples - 1), 0.5] if samples % 2 == 0 else np.ones(samples)
        mean = np.convolve(rng.standard_normal(100_000), weights / samples, "same")
        noise = Noise.given({A: 1.0}, [A])
        log = Log.from_arrays({"run": np.zeros(100_000, int), A: mean, "t_s": np.arange(1e5)}, noise)
        log = corrected(log, [read_correction(f"averaged hall_a_m {samples}")])
        assert np.std(log.array(A)) == pytest.approx(log.noise[A].value, rel=0.02)


def test_every_kind_is_made_here():
    assert {text.split()[0] for text in WRONG} | {"averaged"} == set(MISTAKES)


@pytest.mark.parametrize("text", [*WRONG, "averaged hall_a_m 5"])
def test_a_file_that_is_streamed_reads_as_arrays_do(right, text, tmp_path, monkeypatch):
    wrong = right | WRONG.get(text, lambda d: {})(right)
    write_log(wrong, tmp_path / "log.csv")
    held = corrected(Log.from_arrays(wrong), [read_correction(text)])
    expected = {c: held.array(c) for c in right}
    streamed = read_log(tmp_path / "log.csv")
    monkeypatch.setattr(type(streamed.table), "in_memory", False)
    streamed = corrected(streamed, [read_correction(text)])
    assert streamed.rows == held.rows
    for c in (A, B, X):
        parts = [block.data[c] for block in streamed.blocks((c,), size=37)]
        assert np.concatenate(parts) == pytest.approx(expected[c], rel=1e-9), c


def test_noise_follows_what_is_undone(right):
    """What was estimated is that of the numbers; what was stated is in SI and stays."""
    guessed = Log.from_arrays(right, Noise.given({A: 1e-3, B: 2e-3, X: 3e-3}, list(right)))
    for text, expected in (
        ("exchange hall_a_m hall_b_m", {A: 2e-3, B: 1e-3, X: 3e-3}),
        ("scale x_ref_m mm", {A: 1e-3, B: 2e-3, X: 3e-3}),
        ("coarse_steps x_ref_m 0.012", {A: 1e-3, B: 2e-3, X: np.hypot(3e-3, 0.012 / np.sqrt(12))}),
        ("sign hall_a_m in 3", {A: 1e-3, B: 2e-3, X: 3e-3}),
    ):
        assert corrected(guessed, [read_correction(text)]).noise.std == pytest.approx(expected), text


# -- in a calibration --------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_calibration_keeps_corrections_and_claims_and_reads_the_next_log_with_them(tmp_path):
    columns = record(seed=1, samples=30)
    late = columns["run"] == 4
    mistaken = columns | {
        A: columns[B], B: columns[A], X: np.where(late, -columns[X], columns[X]),
    }  # fmt: skip
    texts = ["exchange hall_a_m hall_b_m", "sign x_ref_m in 4"]
    result = fit(with_noise(mistaken), "stage31", solver="direct", corrections=texts[:1])
    claim = Claim("sign", "It is inverted.", (X,), (4,), texts[1], 0.98, ("sign hall_c_m in 4",))
    result = result.changed(claims=(claim,))
    result.save(tmp_path / "calib.json")
    back = load_fit(tmp_path / "calib.json")
    assert (back.corrections, back.claims) == (result.corrections, result.claims)
    whole = fit(with_noise(mistaken), "stage31", solver="direct", corrections=texts)
    assert [one.text for one in whole.corrections] == texts
    assert not whole.claims
    whole.save(tmp_path / "calib.json")
    plain = fit(with_noise(columns), "stage31", solver="direct")
    assert whole.values == pytest.approx(plain.values, rel=1e-9)
    next_log = record(seed=2, samples=30)
    wired = with_noise(next_log | {A: next_log[B], B: next_log[A]})  # of single runs: of that log alone
    found = evaluate(load_fit(tmp_path / "calib.json"), wired)
    assert found.table.over()["rmse"] == pytest.approx(
        evaluate(plain, with_noise(next_log)).table.over()["rmse"]
    )


def test_a_mistake_that_begins_with_a_run_has_words():
    one = read_correction("stuck hall_a_m 0 40 in 3")
    assert said(one) == "the values of hall_a_m stand still from sample 0 to 40 in run 3"
