"""Decode a log block by block, by the nominal and by the fitted parameters."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hallsym.estimation import Fit, columns_of, decoder_near, nominal_variance
from hallsym.log import Block, Log, extended
from hallsym.log.batches import SIZE, Weigh
from hallsym.log.phase import designed


class Decoder:
    """Pose of a block by the nominal or by the fitted parameters, (n_pose, samples) each."""

    def __init__(self, fit: Fit) -> None:
        """Compile the decoder of the fit's model."""
        self.fit, self.model = fit, fit.model
        self._nominal = designed(fit.model, fit.values)
        variance = np.array([fit.noise[c].value ** 2 for c in fit.model.channels])
        self._decode_nominal = decoder_near(fit.model, nominal_variance(fit.model, variance))
        self._decode = decoder_near(fit.model, variance)

    def zeros(self, run: int, first_state: np.ndarray) -> np.ndarray:
        """Return the displacements delta / phi(0) of one run, Eq. (31)."""
        delta = self.fit.zeros.get(run)
        if delta is None or not len(self.model.zeros):
            return np.zeros(len(self.model.zeros))
        return np.asarray(delta) / self.model.zero_scale(self.fit.values, first_state)

    def nominal(self, block: Block) -> np.ndarray:
        """Return the pose by the nominal parameters, without zero deviations."""
        return self._pose(self._decode_nominal, block, self._nominal, np.zeros(len(self.model.zeros)))

    def fitted(self, block: Block, zeros: np.ndarray) -> np.ndarray:
        """Return the pose by the fitted parameters; `zeros` of the block's run."""
        return self._pose(self._decode, block, self.fit.values, zeros)

    def _pose(
        self, decode: Callable[..., np.ndarray], block: Block, p: np.ndarray, zeros: np.ndarray
    ) -> np.ndarray:
        model = self.model
        readings, state = ([block.data[c] for c in names] for names in (model.channels, model.state))
        reference = np.array([block.data[c] for c in model.references])
        return decode(p, zeros, readings, state, reference)


@dataclass(frozen=True, eq=False)
class Decoded:
    """A block with its decoded poses, (n_pose, samples) each; what is not asked for is not computed.

    `zeros`: displacements of the run. `kept`: (samples,) whether each sample counts.
    """

    block: Block
    decoder: Decoder
    zeros: np.ndarray
    kept: np.ndarray

    def rows(self, columns: tuple[str, ...]) -> np.ndarray:
        """Return columns of the block, (columns, samples)."""
        return np.array([self.block.data[c] for c in columns]).reshape(len(columns), len(self.kept))

    @property
    def time(self) -> np.ndarray:
        """Time [s], (1, samples); zeros where it is not logged."""
        return self.rows(("t_s",)) if "t_s" in self.block.data else np.zeros((1, len(self.kept)))

    @cached_property
    def reference(self) -> np.ndarray:
        """The logged pose."""
        return self.rows(self.decoder.model.references)

    @cached_property
    def nominal(self) -> np.ndarray:
        """The pose by the nominal parameters."""
        return self.decoder.nominal(self.block)

    @cached_property
    def fitted(self) -> np.ndarray:
        """The pose by the fitted parameters."""
        return self.decoder.fitted(self.block, self.zeros)


def decoded(log: Log, fit: Fit, keep: Weigh | None = None) -> Iterator[Decoded]:
    """Yield the blocks of `log` in order, each with what decodes it; samples of weight 0 do not count."""
    decode, model = Decoder(fit), fit.model
    columns = (*columns_of(model), *(("t_s",) if "t_s" in log.columns else ()))
    sigma = {c: s.value for c, s in fit.noise.sigmas.items()}
    zeros: dict[int, np.ndarray] = {}
    for block in extended(log, model, sigma, model.named(fit.values)).blocks(columns, size=SIZE):
        if block.run not in zeros:
            zeros[block.run] = decode.zeros(block.run, np.array([block.data[c][0] for c in model.state]))
        count = len(block.data[columns[0]])
        kept = np.ones(count, dtype=bool) if keep is None else keep(block) > 0
        yield Decoded(block, decode, zeros[block.run], kept)
