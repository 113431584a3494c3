"""Machines with a hidden gap, in plain numpy: they share no code with the effects that shall find it.

The paper's stage with Table 7's values, small imperfections that are in every machine (a gain that bends with
height, a cubic field, 1/f noise), three kinds of campaign, and one injected effect, two, none, or one that no
catalogue lists. Readings in m, times in s.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from twins import TRUTH, phi, pm

from hallsym.log import Log, Meta, Noise, Sigma

SIGMA = {
    **dict.fromkeys(("hall_a_m", "hall_b_m", "hall_c_m"), 0.5e-6),
    "x_ref_m": 0.3e-6, "y_ref_m": 0.3e-6, "rz_ref_rad": 0.5e-6,
    "z_m": 12e-9, "rx_rad": 80e-9, "ry_rad": 80e-9,
}  # fmt: skip
STEP = 0.002


@dataclass
class Motion:
    """The true motion of one run on the full clock: pose (3, n), state (3, n), times, temperature."""

    t: np.ndarray
    start: float
    pose: np.ndarray
    state: np.ndarray
    temperature: np.ndarray
    share: float
    reading: np.ndarray | None = None
    felt: np.ndarray | None = None
    reference: np.ndarray | None = None


Inject = Callable[[Motion, np.random.Generator], None]


def grid(rng: np.random.Generator, settings: int = 19, span: float = 2.5e-4) -> list[Motion]:
    """Single-axis sines at many vertical settings, as in the paper."""
    runs, start = [], 0.0
    for _ in range(settings):
        level = rng.uniform(-1, 1, 3) * np.array([span, 2 * span, 2 * span])
        for axis, size in ((1, 500e-6), (0, 300e-6), (2, 300e-6)):
            t = np.arange(500) * STEP
            pose = np.zeros((3, 500))
            pose[axis] = size * np.sin(2 * np.pi * t)
            runs.append(_run(t, start, pose, np.tile(level[:, None], 500), len(runs) / (3 * settings)))
            start += rng.uniform(15, 45)
    return runs


def multisine(rng: np.random.Generator, fastest: float = 12.0) -> list[Motion]:
    """All axes at once, several frequencies, vertical state moving slowly."""
    runs, start = [], 0.0
    for k in range(8):
        t = np.arange(4000) * STEP
        pose = np.zeros((3, len(t)))
        for axis, size in ((0, 300e-6), (1, 500e-6), (2, 300e-6)):
            f = np.geomspace(0.4, fastest, 6) * rng.uniform(0.9, 1.1, 6)
            for i, fi in enumerate(f):
                pose[axis] += size / (2.5 * (1 + i)) * np.sin(2 * np.pi * fi * t + rng.uniform(0, 6.28))
        state = np.array([a * np.sin(2 * np.pi * rng.uniform(0.05, 0.2) * t + rng.uniform(0, 6.28))
                          for a in (1e-4, 2.5e-4, 2.5e-4)])  # fmt: skip
        runs.append(_run(t, start, pose, state, k / 8))
        start += rng.uniform(30, 40)
    return runs


def raster(rng: np.random.Generator) -> list[Motion]:
    """Triangles on x and y, slow Rz, vertical state moving slowly."""
    runs, start = [], 0.0
    for k in range(8):
        t = np.arange(4000) * STEP
        fast, slow = rng.uniform(0.8, 1.2), rng.uniform(0.08, 0.15)
        a, b = (fast, slow) if k % 2 else (slow, fast)
        pose = np.array([280e-6 * _triangle(a * t + rng.random()), 470e-6 * _triangle(b * t + rng.random()),
                         250e-6 * np.sin(2 * np.pi * rng.uniform(0.1, 0.3) * t)])  # fmt: skip
        wide = np.pad(pose, ((0, 0), (8, 8)), mode="reflect", reflect_type="odd")
        pose = np.array([np.convolve(row, np.ones(17) / 17, "valid") for row in wide])
        state = np.array([s * np.sin(2 * np.pi * rng.uniform(0.05, 0.2) * t + rng.uniform(0, 6.28))
                          for s in (1e-4, 2e-4, 2e-4)])  # fmt: skip
        runs.append(_run(t, start, pose, state, k / 8))
        start += rng.uniform(30, 40)
    return runs


def _triangle(phase: np.ndarray) -> np.ndarray:
    return 1 - 4 * np.abs(np.mod(phase, 1) - 0.5)


def turning(rng: np.random.Generator) -> list[Motion]:
    """The multisine with thirty times the rotation, so that finite rotation shows."""
    runs = multisine(rng)
    for run in runs:
        run.pose[2] *= 30
    return runs


CAMPAIGNS = {"grid": grid, "multisine": multisine, "raster": raster, "turning": turning}


def _run(t: np.ndarray, start: float, pose: np.ndarray, state: np.ndarray, share: float) -> Motion:
    warm = 20 + 4 * np.sin(5 * share + 0.02 * t) + 0.5 * t / 8
    return Motion(t, start, pose, state, warm, share)


def gains(state: np.ndarray) -> np.ndarray:
    """Gain of each probe, Eq. (31)."""
    return phi(TRUTH, state)


def machine(
    campaign: str = "grid",
    inject: tuple[Inject, ...] = (),
    *,
    seed: int,
    temperature: bool = False,
    pink: float = 0.3,
    curvature: float = 0.3,
    noise: str = "white",
    thin: int = 3,
) -> Log:
    """Return the log of a machine with a hidden gap; every fifth run is held out."""
    rng = np.random.default_rng(seed)
    runs = CAMPAIGNS[campaign](rng)
    before: list[Inject] = [i for i in inject if not getattr(i, "late", False)]
    late: list[Inject] = [i for i in inject if getattr(i, "late", False)]
    bend, cubic = rng.normal(0, 1.5e4 * curvature, 3), rng.normal(0, 2e-3 * curvature, 3)
    columns: dict[str, list[np.ndarray]] = {}
    for number, run in enumerate(runs):
        run.felt = pm(TRUTH) @ run.pose + rng.normal(0, 1e-6, 3)[:, None]
        run.felt = run.felt + cubic[:, None] * run.felt**3 / 0.25e-6
        run.reference = run.pose.copy()
        run.reading = (gains(run.state) + bend[:, None] * run.state[0] ** 2) * run.felt
        for effect in before:
            effect(run, rng)
        n = len(run.t)
        keep = slice(None, None, thin)
        out = {"run": np.full(n, number), "t_s": run.start + run.t}
        for k, c in enumerate(("hall_a_m", "hall_b_m", "hall_c_m")):
            out[c] = run.reading[k] + SIGMA[c] * _noise(rng, n, noise, pink)
        for rows, names in (
            (run.reference, ("x_ref_m", "y_ref_m", "rz_ref_rad")),
            (run.state, ("z_m", "rx_rad", "ry_rad")),
        ):
            for row, c in zip(rows, names, strict=True):
                out[c] = row + SIGMA[c] * _noise(rng, n, noise, 0.0)
        if temperature:
            out["temperature_degc"] = run.temperature + 0.02 * rng.standard_normal(n)
        for effect in late:
            effect(run, rng, out)  # they act on the recorded columns
        for c, values in out.items():
            columns.setdefault(c, []).append(values[keep])
    total = len(runs)
    held = tuple(range(2, total, 5)) if total > 10 else (2, 6)
    meta = Meta(base_model="stage31", holdout=held, gap_length_scale_m=0.35, gap_threshold_rel=0.05)
    return Log.from_arrays(
        {c: np.concatenate(v) for c, v in columns.items()},
        noise=Noise({c: Sigma(s, "given") for c, s in SIGMA.items()}), meta=meta,
    )  # fmt: skip


def hidden(name: str, campaign: str, seed: int = 1, kind: Callable | None = None, **options) -> Log:
    """Return the log of a machine that hides one of the listed effects, or one of another kind."""
    effect = (kind or listed)(np.random.default_rng(seed))[name]
    return machine(campaign, (effect,), seed=seed, temperature="temperature" in name, **options)


def _noise(rng: np.random.Generator, n: int, kind: str, pink: float) -> np.ndarray:
    white = rng.standard_normal(n)
    if kind == "correlated":
        drive = rng.standard_normal(n + 50)
        out = np.empty(n + 50)
        out[0] = drive[0]
        for k in range(1, n + 50):
            out[k] = 0.8 * out[k - 1] + 0.6 * drive[k]
        white = out[50:]
    if pink:
        f = np.fft.rfftfreq(n)
        f[0] = f[1]
        slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) / np.sqrt(f), n)
        white = np.sqrt(1 - pink**2) * white + pink * slow / slow.std()
    return white


# -- effects of the catalogue, typed a second time --------------------------------------------------------

U = 0.5e-3


def _d(x: np.ndarray, n: int = 1) -> np.ndarray:
    for _ in range(n):
        x = np.gradient(x, STEP, axis=-1, edge_order=2)
    return x


def add(f: Callable[[Motion], np.ndarray]) -> Inject:
    """Return what adds `f` to the readings."""

    def inject(m: Motion, _: np.random.Generator) -> None:
        m.reading = m.reading + f(m)

    return inject


def listed(rng: np.random.Generator) -> Mapping[str, Inject]:
    """One draw of every effect, about twice the noise floor where it shows at all."""
    w = lambda: rng.uniform(0.5, 1.0, 3)[:, None] * rng.choice([-1.0, 1.0])  # noqa: E731
    free = lambda *s: rng.normal(0, 1, s)  # noqa: E731
    a, _, c3 = w(), free(3, 1), free(3, 3)
    slip, when, who = rng.uniform(0.01, 0.02), rng.uniform(0.3, 0.7), int(rng.integers(3))
    hum, phase = rng.choice([50.0, 60.0]) + rng.uniform(-0.05, 0.05), rng.uniform(0, 6.28, 3)[:, None]

    def play(m: Motion) -> np.ndarray:
        width, out = 6e-5, np.zeros_like(m.reading)
        p = np.zeros(3)
        for k in range(m.reading.shape[1]):
            p = np.clip(p, m.reading[:, k] - width, m.reading[:, k] + width)
            out[:, k] = (p - m.reading[:, k]) / width
        return 3e-6 * np.abs(a) * out

    def drift(m: Motion, _: np.random.Generator) -> None:
        m.reference += 4e-6 * c3[:, :1] / 4 * m.t

    def turned(m: Motion) -> np.ndarray:
        """What a rigid rotation adds to the small-angle displacement."""
        v = TRUTH
        px = np.array([v["H1x"], -v["H2x"], v["H3x"]])[:, None]
        py = np.array([v["H1y"], v["H2y"], v["H3y"]])[:, None]
        angle = np.array([v["theta_A"] + np.pi / 2, v["theta_B"] + np.pi / 2, v["theta_C"]])[:, None]
        x, y, rz = m.pose
        dx = (px + x) * (np.cos(rz) - 1) - (py + y) * np.sin(rz) + py * rz
        dy = (py + y) * (np.cos(rz) - 1) + (px + x) * np.sin(rz) - px * rz
        return gains(m.state) * (np.cos(angle) * dx + np.sin(angle) * dy)

    def skew(m: Motion) -> np.ndarray:
        r = m.reading
        return 1.0e-3 * -_d(r) + 0.5e-6 * _d(r, 2) - 1e-9 / 6 * _d(r, 3)

    return {
        "height_quadratic": add(lambda m: a * 3e5 * m.state[0] ** 2 * m.felt),
        "odd_nonlinearity": add(lambda m: a * 0.02 * m.felt**3 / U**2),
        "even_nonlinearity": add(lambda m: a * 0.02 * m.felt**2 / U),
        "time_skew": add(skew),
        "hysteresis": add(play),
        "gain_temperature_drift": add(lambda m: a * 2e-3 * (m.temperature - 20) * m.felt),
        "gain_time_drift": add(lambda m: a * 0.02 * (1 - np.exp(-3 * (m.share))) * m.felt),
        "mount_slip": add(lambda m: (np.arange(3) == who)[:, None] * (m.share > when) * slip * m.felt),
        "motor_stray_field": add(lambda m: 6e-6 * 0.5 * c3 @ _d(m.pose, 2)),
        "mains_hum": add(lambda m: 0.9e-6 * np.sin(2 * np.pi * hum * (m.start + m.t) + phase)),
        "saturation": add(lambda m: np.clip(m.reading, -2.4e-4, 2.4e-4) - m.reading),
        "reference_drift": drift,
        "second_order_rotation": add(turned),
    }


def faulty(rng: np.random.Generator) -> Mapping[str, Inject]:
    """Faults of samples, which act on the recorded columns."""
    halls = ("hall_a_m", "hall_b_m", "hall_c_m")

    def late(f: Callable) -> Inject:
        f.late = True
        return f

    @late
    def outliers(m: Motion, rng: np.random.Generator, out: dict) -> None:
        for c in halls:
            hit = rng.random(len(m.t)) < 0.003
            out[c] = out[c] + hit * rng.choice([-1, 1], len(m.t)) * 2e-5

    @late
    def jitter(m: Motion, rng: np.random.Generator, out: dict) -> None:
        shift = 6e-4 * rng.standard_normal(len(m.t))
        for row, c in zip(_d(m.reading), halls, strict=True):
            out[c] = out[c] + row * shift

    @late
    def steps(m: Motion, rng: np.random.Generator, out: dict) -> None:
        for c in halls:
            out[c] = np.round(out[c] / 2.5e-6) * 2.5e-6

    return {
        "outliers": outliers,
        "clock_jitter": jitter,
        "adc_quantisation": steps,
    }


def unlisted(rng: np.random.Generator) -> Mapping[str, Inject]:
    """Effects that no catalogue lists."""
    place, width, per, ring = (
        rng.uniform(-1e-4, 1e-4),
        rng.uniform(2e-5, 5e-5),
        rng.uniform(2e-5, 6e-5),
        rng.uniform(20, 35),
    )
    a = rng.uniform(0.5, 1.0, 3)[:, None]

    def screw(m: Motion, _: np.random.Generator) -> None:
        m.reference[0] += 1.8e-6 * np.sin(2 * np.pi * m.pose[0] / per)
        m.reference[1] += 1.8e-6 * np.sin(2 * np.pi * m.pose[1] / per + 1)

    def ringing(m: Motion) -> np.ndarray:
        push = _d(m.pose, 2)[:2].sum(axis=0)
        out, x, v = np.zeros(len(m.t)), 0.0, 0.0
        w = 2 * np.pi * ring
        for k, p in enumerate(push):
            v += STEP * (-(w**2) * x - 2 * 0.02 * w * v + p)
            x += STEP * v
            out[k] = x
        out -= push / w**2
        return a * 3e-6 * out / max(out.std(), 1e-12)

    def wander(m: Motion) -> np.ndarray:
        noise = np.random.default_rng(int(m.start * 1000) % 2**31).standard_normal((3, len(m.t)))
        kernel = np.exp(-0.5 * (np.arange(-60, 61) / 20) ** 2)
        slow = np.array([np.convolve(row, kernel, "same") for row in noise])
        return 2e-6 * slow / slow.std()

    return {
        "bump": add(lambda m: 8e-6 * a * np.exp(-0.5 * ((m.felt - place) / width) ** 2)),
        "ripple": add(lambda m: 2e-6 * a * np.sin(2 * np.pi * m.felt / per)),
        "screw": screw,
        "ringing": add(ringing),
        "speed_gain": add(lambda m: 0.02 * a * np.abs(_d(m.felt)) / 3e-3 * m.felt),
        "wander": add(wander),
        "run_gain": add(lambda m: a * 0.01 * np.sin(97.3 * m.start) * m.felt),
    }
