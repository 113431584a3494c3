"""What a decoupler computes in one arithmetic, in numpy as C does: range test, hash, errors, vectors."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from hallsym.codegen.bounds import Bounds
from hallsym.codegen.decoupler import Decoupler, flag_bit

COUNT = 48
"""Vectors within the box that the self-test lists."""
BATCH = 1 << 16
"""Samples that are computed at a time."""


def mix(x: np.ndarray) -> np.ndarray:
    """Return 32 well-mixed bits of each 32-bit number (the `mix` of test/selftest.c)."""
    x = np.asarray(x, dtype=np.uint32).copy()
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B)):
        x ^= x >> np.uint32(shift)
        x *= np.uint32(factor)
    return x ^ (x >> np.uint32(16))


@dataclass(frozen=True)
class Port:
    """An input or output of the generated functions: its C type and name, unit, and the SI value of 1."""

    column: str
    type: str
    member: str
    unit: str
    scale: float = 1.0


@dataclass(frozen=True, eq=False)
class Vectors:
    """Listed vectors: `inputs` (n_inputs, s), `held` those brought back into the box [SI], `status` (s,).

    `pose` (n_pose, s): of the model in double.
    """

    inputs: np.ndarray
    held: np.ndarray
    pose: np.ndarray
    status: np.ndarray


@dataclass(frozen=True, eq=False)
class Arithmetic(ABC):
    """The numbers of one decoupler: float, double, or integers."""

    decoupler: Decoupler

    batch: ClassVar[int] = BATCH
    """Random samples that are drawn at a time."""

    @property
    @abstractmethod
    def type(self) -> str:
        """The name of its numbers: float, double or q31."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """Range and rounding error bound of the pose over the box."""

    @property
    @abstractmethod
    def error_bound(self) -> Mapping[str, float]:
        """Bound of |computed - model| [SI] by pose column: rounding, approximations, everything."""

    @property
    @abstractmethod
    def inputs(self) -> Sequence[Port]:
        """Readings, then state."""

    @property
    @abstractmethod
    def outputs(self) -> Sequence[Port]:
        """Pose coordinates."""

    @property
    def limited(self) -> Sequence[str]:
        """Inputs that have a range."""
        return self.decoupler.inputs

    @property
    @abstractmethod
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Least and greatest value of the inputs in their own numbers, (n_inputs, 1) each."""

    @property
    def span(self) -> tuple[np.ndarray, np.ndarray]:
        """The same, between which random inputs are drawn."""
        return self.ends

    @abstractmethod
    def run(self, held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and bits of the flags (s,) of inputs within the box: the same bits as C."""

    @abstractmethod
    def sample(self, numbers: np.ndarray) -> np.ndarray:
        """Return inputs (n_inputs, s) of numbered samples, as `sample` of test/selftest.c makes them."""

    @abstractmethod
    def _words(self, pose: np.ndarray) -> np.ndarray:
        """Return the 32 bits (n_pose, s) of a pose that the hash takes."""

    @abstractmethod
    def _rounded(self, inputs: np.ndarray) -> np.ndarray:
        """Return inputs as numbers of this arithmetic."""

    @abstractmethod
    def _chosen(self) -> np.ndarray:
        """Return the inputs (n_inputs, s) that the self-test lists."""

    def _trials(self, rng: np.random.Generator, count: int) -> np.ndarray:
        """Return random inputs (n_inputs, count) in the box, in the unit of their own numbers."""
        return self.decoupler.trials(rng, count, np.array(self.span))

    def hold(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return inputs brought back into the box, and the status bits (s,) of those that were not in it."""
        low, high = self.ends
        with np.errstate(all="ignore"):
            above, below = ~(inputs <= high), inputs < low
        bits = np.array(self.decoupler.input_bits, dtype=np.uint32)[:, None]
        status = np.bitwise_or.reduce(np.where(above | below, bits, np.uint32(0)), axis=0)
        return np.where(above, high, np.where(below, low, inputs)), status

    def step(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and status (s,) of inputs (n_inputs, s), whatever their bits, as C does."""
        held, status = self.hold(inputs)
        pose, flags = self.run(held)
        return pose, status.astype(np.uint32) | flags.astype(np.uint32)

    def hashed_step(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return pose (n_pose, s) and status (s,) of numbered samples, as the hash of the self-test takes
        them."""
        return self.step(self.sample(numbers))

    def hash(self, count: int) -> int:
        """Return the hash of status and pose over samples 0 to count - 1."""
        total, width = 0, np.uint32(len(self.decoupler.pose) + 1)
        for first in range(0, count, BATCH):
            n = np.arange(first, min(first + BATCH, count), dtype=np.uint32)
            pose, status = self.hashed_step(n)
            for k, row in enumerate((status, *self._words(pose))):
                total += int(mix(row ^ mix(n * width + np.uint32(k))).astype(np.uint64).sum())
        return total & 0xFFFFFFFF

    def errors(self, samples: int | None = None, seed: int = 0) -> dict[str, float]:
        """Return the largest error of each pose coordinate against the model, over random inputs."""
        d, rng, most = self.decoupler, np.random.default_rng(seed), np.zeros(len(self.decoupler.pose))
        samples = d.tried if samples is None else samples
        for first in range(0, samples, self.batch):
            count = min(self.batch, samples - first)
            inputs = self._rounded(self._trials(rng, count))
            pose, status = self.step(inputs)
            error = d.difference(_si(pose, self.outputs), d.exact(_si(inputs, self.inputs)))
            most = np.maximum(most, np.abs(error[:, status == 0]).max(axis=1, initial=0.0))
        return dict(zip(d.pose, most.tolist(), strict=True))

    @cached_property
    def vectors(self) -> Vectors:
        """The vectors of the self-test: where a flag says that there is no pose, what is computed."""
        d, inputs = self.decoupler, self._chosen()
        held = _si(self.hold(inputs)[0], self.inputs)
        pose, status = self.step(inputs)
        found, exact = _si(pose, self.outputs), d.exact(held)
        if d.model.period:  # on the branch of what is computed
            exact = found - d.difference(found, exact)
        weak = status >= flag_bit(len(d.flags) - 1) if d.flags else np.zeros(len(status), bool)
        if d.drawn is not None:  # inputs brought back into the box belong to no pose
            weak = status > 0
        return Vectors(inputs, held, np.where(weak, found, exact), status)


def _si(values: np.ndarray, ports: Sequence[Port]) -> np.ndarray:
    """Return numbers of an arithmetic (n, s) in SI."""
    return values.astype(float) * np.array([[port.scale] for port in ports])
