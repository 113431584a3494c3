"""Signals by their value: the same as waves, as a filter in numpy, as the chain written out in numpy."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hallsym.families import adapted
from hallsym.families.rotary import effects as rotary_effects
from hallsym.families.rotary.models import angle_only, rotary
from hallsym.families.rotary.waveforms import FEW, Waveform, waveform
from hallsym.families.rotary.waves import Wave
from hallsym.log import unwrapped

ANGLES = np.linspace(-3, 9, 25)
NUMBERS = st.floats(-2, 2)
SOME = st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=4)


def make_of(text: str):
    """An effect as `--effect` takes it."""
    return lambda model: adapted(model, (text,), {})


def wave_of(terms: list[tuple[float, float]]) -> Wave:
    return Wave({n: (ca.SX(c), ca.SX(s if n else 0.0)) for n, (c, s) in enumerate(terms)})


def values(*signals: Wave | Waveform) -> np.ndarray:
    theta = ca.SX.sym("theta")
    f = ca.Function("f", [theta], [ca.vertcat(*(s.at(theta) for s in signals))])
    return np.array(f(ANGLES[None]))


def low_pass(n: int) -> tuple[ca.SX, ca.SX]:
    return ca.SX(1 / (1 + (0.3 * n) ** 2)), ca.SX(-0.3 * n / (1 + (0.3 * n) ** 2))


@settings(max_examples=12, deadline=None)
@given(SOME, SOME, NUMBERS)
def test_a_waveform_is_its_wave(first: list, second: list, number: float) -> None:
    a, b = wave_of(first), wave_of(second)

    def chain(a, b):
        v = (a * b + number) * b - a.ahead(number) * 0.5
        return v.filtered(low_pass).slope() * a + number * v

    waves = values(chain(a, b))
    for mixed in (chain(waveform(a), waveform(b)), chain(waveform(a), b), chain(a, waveform(b))):
        assert isinstance(mixed, Waveform)
        assert np.allclose(values(mixed), waves, rtol=0, atol=1e-12 * max(1.0, np.abs(waves).max()))


@pytest.mark.parametrize("power", [2, FEW + 3])
def test_a_filter_is_that_of_the_spectrum(power: int) -> None:
    """Few harmonics are multiplied out, many come from values: both as numpy's transform has them."""
    v = waveform(wave_of([(0.2, 0.0), (1.0, -0.4)]))
    made = v
    for _ in range(power - 1):
        made = made * v
    assert made.degree == power
    grid = 2 * np.pi * np.arange(64) / 64
    spectrum = np.fft.rfft((0.2 + np.cos(grid) - 0.4 * np.sin(grid)) ** power)
    spectrum /= 1 + 0.3j * np.arange(len(spectrum))
    n = np.arange(1, len(spectrum))
    expected = spectrum[0].real / 64 + 2 / 64 * np.real(np.exp(1j * ANGLES[:, None] * n) @ spectrum[1:])
    assert np.allclose(values(made.filtered(low_pass))[0], expected, rtol=0, atol=1e-12)


def test_the_angle_behind_bent_voltages_is_that_of_the_formula() -> None:
    texts = ("third_harmonic_distortion:phase=free", "even_nonlinearity:order=4", "odd_nonlinearity:order=5")
    model = rotary_effects.direct(rotary(angle_only()))
    for text in texts:
        model = make_of(text)(model)
    rng = np.random.default_rng(3)
    base = {"Vx": 0.02, "Vy": -0.03, "Ax": 1.0, "Ay": 1.05, "beta": 0.02, "zero": 0.4}
    new = {n: float(rng.uniform(-0.02, 0.02)) for n in model.names if n not in base}
    u = ANGLES + base["zero"]
    field = np.exp(1j * u)
    q = sum(new[f"third_harmonic_distortion_m3_{p}"] * f for p, f in (("re", 1), ("im", 1j)))
    shifted = np.exp(1j * (u + base["beta"]))
    x = base["Vx"] + base["Ax"] * (field + q * np.exp(-3j * u)).real
    y = base["Vy"] + base["Ay"] * (shifted + q * np.exp(-3j * (u + base["beta"]))).imag
    for effect, powers in (("even_nonlinearity", (2, 4)), ("odd_nonlinearity", (3, 5))):
        x, y = (
            v + sum(new[f"{effect}{j}_{plate}"] * v**power for j, power in enumerate(powers))
            for plate, v in (("cos", x), ("sin", y))
        )
    expected = u + np.angle((x + 1j * y) * np.exp(-1j * u))
    reading = model.reading(model.vector(base | new), [], ANGLES[None], np.zeros((0, len(ANGLES))))
    assert np.allclose(np.array(reading)[0], expected, rtol=0, atol=1e-13)


@given(st.lists(st.floats(-20, 20), max_size=30))
def test_a_column_is_unwrapped_as_numpy_does(x: list[float]) -> None:
    steps = np.diff(np.array(x)) / 2.5
    if np.any(np.abs(np.abs(steps - np.round(steps)) - 0.5) < 1e-9):
        return  # half a period either way
    assert np.allclose(unwrapped(np.array(x), 2.5), np.unwrap(x, period=2.5), rtol=0, atol=1e-12)
