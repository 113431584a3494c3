"""Self-test: inputs, the pose that the model gives for them in double, and the bits that C shall give."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hallsym.codegen.parts import Decoupler, flag_bit
from hallsym.codegen.printer import Real

COUNT = 48
"""Vectors within the box that are listed."""
BATCH = 1 << 16


def mix(x: np.ndarray) -> np.ndarray:
    """Return 32 well-mixed bits of each 32-bit number (the `mix` of test/selftest.c)."""
    x = np.asarray(x, dtype=np.uint32).copy()
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    return x ^ (x >> np.uint32(16))


@dataclass(frozen=True, eq=False)
class Emulator:
    """The generated arithmetic, operation by operation in the generated type: the same bits as C.

    IEEE 754 leaves no freedom to +, -, *, / and comparisons that round to nearest one by one.
    """

    d: Decoupler
    real: Real

    @cached_property
    def _run(self) -> Callable[..., list[np.ndarray]]:
        return self.d.on_arrays(self.real.dtype)

    @cached_property
    def _ends(self) -> tuple[np.ndarray, np.ndarray]:
        low, high = np.array([self.d.ends(c) for c in self.d.inputs]).T.astype(self.real.dtype)
        return low[:, None], high[:, None]

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and status (s,) of inputs (n_inputs, s), whatever their bits."""
        low, high = self._ends
        with np.errstate(all="ignore"):
            above, below = ~(inputs <= high), inputs < low
        status = ((above | below) * (1 << np.arange(len(inputs), dtype=np.uint32))[:, None]).sum(axis=0)
        held: np.ndarray = np.where(above, high, np.where(below, low, inputs)).astype(self.real.dtype)
        with np.errstate(under="ignore"):
            pose, *seen = self._run(held, [np.array([c], dtype=self.real.dtype) for c in self.d.constants])
        if seen:
            status |= self.d.raised(seen[0].astype(self.real.dtype), self.real.dtype)
        return pose.astype(self.real.dtype), status.astype(np.uint32)

    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Return the inputs (n_inputs, s) of numbered samples, as `sample` of test/selftest.c makes them.

        Most lie in the box, every 16th has any bits at all, every 16th is four times too large.
        """
        low, high = self._ends
        n = np.asarray(numbers, dtype=np.uint32)
        count = np.uint32(len(self.d.inputs))
        kind = mix(n ^ np.uint32(0x9E3779B9)) & np.uint32(15)
        raw = mix(n * count + np.arange(1, count + 1, dtype=np.uint32)[:, None])
        share = (raw >> np.uint32(8)).astype(self.real.dtype) * self.real.dtype(2.0**-24)
        with np.errstate(all="ignore"):
            value = low + (high - low) * share
            value = np.where(kind == 1, value * self.real.dtype(4), value)
        if self.real.size == 4:
            wild = raw.view(np.float32)
        else:
            wild = ((raw.astype(np.uint64) << np.uint64(32)) | mix(raw).astype(np.uint64)).view(np.float64)
        return np.where(kind == 0, wild, value).astype(self.real.dtype)

    def hash(self, count: int) -> int:
        """Return the hash of status and pose bits over samples 0 to count - 1."""
        total, width = 0, np.uint32(len(self.d.pose) + 1)
        for first in range(0, count, BATCH):
            n = np.arange(first, min(first + BATCH, count), dtype=np.uint32)
            pose, status = self.step(self.sample(n))
            if self.real.size == 4:
                words = pose.view(np.uint32)
            else:
                bits = pose.view(np.uint64)
                words = (bits >> np.uint64(32)).astype(np.uint32) ^ mix(bits.astype(np.uint32))
            for k, row in enumerate((status, *words)):
                total += int(mix(row ^ mix(n * width + np.uint32(k))).astype(np.uint64).sum())
        return total & 0xFFFFFFFF


@dataclass(frozen=True, eq=False)
class Vectors:
    """Listed vectors: `inputs` (n_inputs, s), `held` those brought back into the box, `status` (s,), `pose`
    (n_pose, s) of the model in double.
    """

    inputs: np.ndarray
    held: np.ndarray
    pose: np.ndarray
    status: np.ndarray


def vectors(d: Decoupler, real: Real) -> Vectors:
    """Return corners and points of the box, and inputs that are out of range or not finite."""
    low, high = np.array([d.ends(c) for c in d.inputs]).T.astype(real.dtype)
    rng = np.random.default_rng(1)
    share = np.hstack([np.zeros((len(low), 1)) + 0.5, rng.random((len(low), COUNT - 1))])
    share[:, 1:9] = rng.choice([0.0, 1.0], (len(low), 8))
    inputs = [
        np.clip(
            (low[:, None] + (high - low)[:, None] * share).astype(real.dtype), low[:, None], high[:, None]
        )
    ]
    bad = []
    for k in range(len(low)):
        for value in (np.nan, np.inf, -np.inf, 2 * low[k], 2 * high[k], np.finfo(real.dtype).max):
            column = inputs[0][:, 9 + k].copy()
            column[k] = value
            bad.append(column)
    bad.append(np.full(len(low), np.nan, dtype=real.dtype))
    bad += [np.array(row, dtype=real.dtype) for row in d.listed]
    given = np.hstack([inputs[0], np.array(bad, dtype=real.dtype).T])
    with np.errstate(invalid="ignore"):
        above, below = ~(given <= high[:, None]), given < low[:, None]
    held = np.where(above, high[:, None], np.where(below, low[:, None], given)).astype(float)
    pose, status = Emulator(d, real).step(given)
    # the model's pose, on the branch of what is computed; where a flag says that there is none, the latter
    exact = pose - d.difference(pose, d.exact(held)) if d.model.period else d.exact(held)
    weak = status >= flag_bit(len(d.flags) - 1) if d.flags else np.zeros(len(status), bool)
    return Vectors(given, held, np.where(weak, pose, exact), status)


def worst(d: Decoupler, real: Real, samples: int = 100_000, seed: int = 0) -> dict[str, float]:
    """Return the largest error of each pose coordinate against the model in double, over random inputs."""
    low, high = np.array([d.ends(c) for c in d.inputs]).T[:, :, None]
    rng, emulator = np.random.default_rng(seed), Emulator(d, real)
    most = np.zeros(len(d.pose))
    for first in range(0, samples, BATCH):
        share = rng.random((len(low), min(BATCH, samples - first)))
        inputs = (low + (high - low) * share).astype(real.dtype)
        pose, status = emulator.step(inputs)
        inside = status == 0
        error = np.abs(d.difference(pose, d.exact(inputs.astype(float))))[:, inside]
        most = np.maximum(most, error.max(axis=1, initial=0.0))
    return dict(zip(d.pose, most.tolist(), strict=True))
