"""Faults of a recording, which no model describes: their remedies, and how each is injected."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hallsym.families.cordic import CHIP_STEPS, cordic_angle, worst_of
from hallsym.families.recording import MISTAKES, Correction
from hallsym.log.phase import wrapped

Size = dict[str, tuple[float, str]]
"""Parameter -> value in SI, unit."""
Noisy = np.ndarray | float
"""Noise of the readings, (K, rows), or 0."""
Draw = Callable[[str], np.random.Generator]
"""The generator of random numbers of that name."""


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording without faults: `clean` readings and their velocity `speed` per second, each (K, rows).

    `run`: of each sample. `step_s`: sampling interval. `sigma`: typical noise of a reading, in `unit`.
    `decoded`: the reading is the decoded angle, one channel without rails or other wires.
    """

    channels: tuple[str, ...]
    clean: np.ndarray
    speed: np.ndarray
    run: np.ndarray
    step_s: float
    sigma: float
    unit: str
    decoded: bool

    @property
    def most(self) -> float:
        """Largest size [unit] of an addition to a reading that still looks like one."""
        return 1e-2 if self.unit == "m" else 1.0


@dataclass(frozen=True, eq=False)
class Injection:
    """An effect or a fault that can be given any size.

    `make(amount, noise)`: the readings, (K, rows). `size(amount)`: its parameters. `most`: largest amount for
    which its name applies. `start`: an amount to begin the search from. `sized`: False where there is nothing
    to scale (an exchanged channel). `name`, `link`: of the effect or fault.
    """

    form: str
    make: Callable[[float, Noisy], np.ndarray]
    size: Callable[[float], Size]
    most: float = 1.0
    start: float = 1.0
    sized: bool = True
    name: str = ""
    link: str = ""


Inject = Callable[[Recording, Draw], Injection | str]


@dataclass(frozen=True, eq=False)
class RecordingFault:
    """A fault that no effect can model. `remedy`: what to do instead.

    `inject(recording, draw)`: how it is injected, or why this recording cannot have it. `rare`: it concerns
    few samples, which can be left out. `of_values`: it shows in the values of the readings themselves, so its
    error is known. `assignment`: the channels are assigned wrongly.
    """

    name: str
    link: str
    meaning: str
    remedy: str
    inject: Inject
    rare: bool = False
    of_values: bool = False
    assignment: bool = False

    @property
    def refusal(self) -> str:
        """Words of a message after the name of the fault."""
        return f"is a fault of the recording, which no model holds: {self.remedy}"


def _one(name: str, unit: str) -> Callable[[float], Size]:
    return lambda amount: {name: (amount, unit)}


# -- single samples ----------------------------------------------------------------------------------------

OUTLIERS = 0.003
"""Share of samples that are spikes."""
HOLD = 3
"""Most samples for which a stale reading is repeated."""
MOST_SHARE = 0.3
"""Share of stale or clipped samples beyond which a recording is no longer one."""


def _spikes(r: Recording, draw: Draw) -> Injection:
    rng = draw("outliers")
    hit = (rng.random(r.clean.shape) < OUTLIERS) * rng.choice([-1.0, 1.0], r.clean.shape)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        return r.clean + noise + amount * hit

    return Injection(
        f"{100 * OUTLIERS:g} % of the samples", make, _one("spike", r.unit), r.most, 10 * r.sigma
    )


def _stale(r: Recording, draw: Draw) -> Injection:
    old = draw("dropped_samples").random(r.run.shape)
    length = draw("dropped").integers(1, 1 + HOLD, r.run.shape)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        return r.clean - r.speed * r.step_s * ages(old < amount, length, r.run) + noise

    return Injection(f"repeated for 1 to {HOLD} samples", make, _one("share", "1"), MOST_SHARE, 0.01)


def ages(begins: np.ndarray, length: np.ndarray, run: np.ndarray) -> np.ndarray:
    """Return the age in samples of each reading: 0 fresh; after a begin it grows until the hold ends."""
    age = np.zeros(len(begins))
    for k in np.flatnonzero(begins):
        n = int(length[k])
        last = min(int(k) + n, len(age))
        aged = np.arange(1, n + 1)[: last - int(k)]
        age[k:last] = np.where(run[k:last] == run[k], aged, age[k:last])
    return age


def _jitter(r: Recording, draw: Draw) -> Injection:
    shift = draw("clock_jitter").standard_normal(r.run.shape)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        return r.clean + noise + amount * r.speed * shift

    return Injection("rms of the sampling instants", make, _one("jitter", "s"), 10 * r.step_s, 0.1 * r.step_s)


def _steps(r: Recording, draw: Draw) -> Injection:
    def make(amount: float, noise: Noisy) -> np.ndarray:
        return np.round((r.clean + noise) / amount) * amount

    return Injection("one step for all channels", make, _one("step", r.unit), r.most / 10, 3 * r.sigma)


def _chip(r: Recording, draw: Draw) -> Injection | str:
    """An angle computed with whole steps of CORDIC; the amount is its largest error [rad]."""
    if not r.decoded:
        return "the readings are no angles"

    def steps(amount: float) -> int:
        """The number whose error is nearest, by ratio."""
        return min(CHIP_STEPS, key=lambda n: abs(float(np.log(worst_of(n) / amount))))

    def make(amount: float, noise: Noisy) -> np.ndarray:
        angle = r.clean + noise
        return angle + wrapped(cordic_angle(np.sin(angle), np.cos(angle), steps(amount)) - angle, 2 * np.pi)

    def size(amount: float) -> Size:
        return {"steps": (float(steps(amount)), "1"), "error_at_most": (worst_of(steps(amount)), "rad")}

    return Injection("whole steps", make, size, worst_of(CHIP_STEPS[0]), 2 * r.sigma)


def inject_rails(r: Recording, draw: Draw) -> Injection | str:
    """Return hard clipping; the amount is the share of the samples beyond the rail of each channel."""
    if r.decoded:
        return "an angle has no rails; the voltages are not logged"

    def levels(share: float) -> np.ndarray:
        return np.quantile(np.abs(r.clean), 1 - share, axis=1)

    def make(amount: float, noise: Noisy) -> np.ndarray:
        rail = levels(amount)[:, None]
        return np.clip(r.clean + noise, -rail, rail)

    def size(amount: float) -> Size:
        return {f"rail_{c}": (float(v), r.unit) for c, v in zip(r.channels, levels(amount), strict=True)}

    return Injection("both rails, hard", make, size, MOST_SHARE, 0.03)


# -- wires -------------------------------------------------------------------------------------------------


def _wired(kind: str) -> Inject:
    """Return how two channels of a pair are exchanged, or the sign of one is inverted."""

    def inject(r: Recording, draw: Draw) -> Injection | str:
        if r.decoded:
            return "one channel has no wires to mix up"
        rng = draw("wiring")
        pair = np.sort(rng.choice(len(r.clean), 2, replace=False)).tolist()
        at = pair if MISTAKES[kind].pair else [int(rng.integers(len(r.clean)))]
        wires = Correction(kind, tuple(r.channels[k] for k in at))

        def make(_: float, noise: Noisy) -> np.ndarray:
            out = dict(zip(r.channels, r.clean + noise, strict=True))
            wires.undo(out, 0)
            return np.array([out[c] for c in r.channels])

        return Injection(" and ".join(wires.columns), make, lambda _: {}, sized=False)

    return inject


REWIRE = "put the wiring right, or fit with --correct 'exchange A B', --correct 'sign A'."
FAULTS = {
    fault.name: fault
    for fault in (
        RecordingFault("outliers", "electronics", "single readings are far off: spikes",
                       "fit with --loss auto or reject, which leave spikes out.",
                       _spikes, rare=True),
        RecordingFault("dropped_samples", "clock", "readings that are older than their time stamp",
                       "repair the acquisition; --loss reject leaves out those that are far off.",
                       _stale, rare=True),
        RecordingFault("clock_jitter", "clock", "sampling instants that scatter",
                       "take readings and reference on one clock, and record again.", _jitter),
        RecordingFault("adc_quantisation", "electronics", "readings that come in steps",
                       "use a finer range or converter; the fit counts step / sqrt(12) as noise.", _steps),
        RecordingFault("cordic_steps", "electronics", "an angle computed with few steps of CORDIC",
                       "let the chip take more steps, or take its raw voltages; an angle stands for a "
                       "range of angles, so that no correction takes more than a few percent off.",
                       _chip, of_values=True),
        RecordingFault("channel_swap", "electronics", "two channels exchanged", REWIRE,
                       _wired("exchange"), assignment=True),
        RecordingFault("sign_inversion", "electronics", "a channel of the other sign", REWIRE,
                       _wired("sign"), assignment=True),
    )
}  # fmt: skip
"""By name: faults that a diagnosis may find and no fit can model."""
ASSIGNMENT_FAULTS = tuple(fault.name for fault in FAULTS.values() if fault.assignment)
"""Faults of the channel assignment, which are confusable for an angle from two channels."""
