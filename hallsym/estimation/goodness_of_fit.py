"""Goodness of fit: the residual in multiples of the noise, overall, by run and by channel.

If the model is right and the noise is as stated, the cost of a fit is chi-square distributed: its value per
degree of freedom is 1 within sqrt(2 / dof). An excess answers two different questions:

- Is it *significant*? Then the noise is not as stated, or the model is wrong, and the standard uncertainties
  are scaled (`covariance`). With 80,000 readings one percent of noise is significant.
- Is it *material*? Then the report begins with it, and a command ends with exit code 3. That is a question of
  size: every real log has a few percent.
"""

import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.special import chdtri

from hallsym.estimation.decoding import gain_at, slopes_by_column
from hallsym.estimation.likelihood import Cost, Point
from hallsym.log import Noise
from hallsym.model import Model

KNOWN = 0.03
"""Relative uncertainty of a noise floor: n samples know a standard deviation to 1 / sqrt(2 n), 560 to 3 %."""
WORTH_REPORTING = 0.05
"""Relative decrease of the error above which a gap is worth reporting, unless the user or the log states
another. A choice."""
OUTWEIGHS = 2.0
"""Cost per degree of freedom above which one channel in one run counts by itself.

There the model error is as large as the noise."""
CERTAIN = 3.0
"""Standard deviations above which a cost per degree of freedom contradicts 1, and the scatter between runs
contradicts the noise (the same probability, 0.13 %)."""
CHANCE = 0.01
"""Probability that noise alone makes the worst of all runs and channels count. The usual 1 %."""
MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class GoodnessOfFit:
    """The residual of a fit in multiples of the noise.

    `residual_over_noise`: the decoded residual error over the noise floor. Contradictions between sensors
    move no pose; they count in `cost_per_degree_of_freedom`: 1 where model and noise are right.
    `degrees_of_freedom`: effective ones: readings less estimates, fewer where noise is autocorrelated.
    `by_run`, `by_channel`: rms residual over its standard deviation by noise. `worst_run`, `worst_channel`:
    the channel in one run with the largest residual, `worst` times the noise; `worst_least` is the lower end
    of that multiple, at 99 % for all runs and channels together. `uncertain`: factor within which the noise
    floor is known; `threshold`: relative decrease of the error that is worth reporting. `noise`: the residual
    over the stated noise, if it is noise; else 0. `what`: the model that does not describe the log where the
    residual is material; `next_command` finds the cause.
    """

    residual_over_noise: float
    cost_per_degree_of_freedom: float
    degrees_of_freedom: float
    by_run: Mapping[int, float]
    by_channel: Mapping[str, float]
    worst_run: int
    worst_channel: str
    worst: float
    worst_least: float
    uncertain: float = 1.0
    threshold: float = WORTH_REPORTING
    noise: float = 0.0
    next_command: str = ""
    what: str = "The model"

    @property
    def limit(self) -> float:
        """Multiple of the noise floor up to which a residual is not worth reporting."""
        return limit_of(self.uncertain, self.threshold)

    @property
    def limit_anywhere(self) -> float:
        """The same for one channel in one run."""
        return OUTWEIGHS**0.5 * self.uncertain

    @property
    def noise_estimated(self) -> bool:
        """Whether a large part of the noise floor is estimated noise."""
        return self.uncertain > 1 + KNOWN

    @property
    def scatter(self) -> float:
        """Standard deviation of the cost per degree of freedom where model and noise are right."""
        return float(np.sqrt(2.0 / self.degrees_of_freedom))

    @property
    def contradicts(self) -> bool:
        """Whether the residual differs significantly from the noise: larger or smaller."""
        return abs(self.cost_per_degree_of_freedom - 1.0) > CERTAIN * self.scatter

    @property
    def significant(self) -> bool:
        """Whether the residual is significantly larger than the noise."""
        return self.contradicts and self.cost_per_degree_of_freedom > 1.0

    @property
    def material(self) -> bool:
        """Whether the residual is so much larger than the noise that a report begins with it."""
        over = self.significant and self.residual_over_noise > self.limit
        return over or self.worst_least > self.limit_anywhere

    @property
    def sentence(self) -> str | None:
        """The first sentence of a report; None where the model describes the log."""
        numbers = self.said(f"{self.what} does not describe this log")
        return numbers and f"{numbers}; next: {self.next_command}".removesuffix("; next: ")

    @property
    def verdict(self) -> str:
        """The first sentence of a report, whether the model describes the log or not."""
        size = f"{self.residual_over_noise:#.3g} times the noise floor{self._guessed}"
        return self.sentence or f"{self.what} describes this log: residual error is {size}{self._more}."

    @property
    def _guessed(self) -> str:
        return ", which was estimated from the log" if self.noise_estimated else ""

    @property
    def _more(self) -> str:
        return f"; up to {_times(self.limit)} is not worth reporting" if self.significant else ""

    def said(self, what: str) -> str | None:
        """Return `what` with its numbers; None where the fit is good."""
        if not self.material:
            return None
        if self.noise:
            return (
                f"The noise is larger than stated: residual error is {_times(self.residual_over_noise)} the "
                f"noise floor, and that is noise, {_times(self.noise)} the stated"
            )
        return (
            f"{what}: residual error is {_times(self.residual_over_noise)} the noise floor{self._guessed}, "
            f"worst in {self.where} ({_times(self.worst)})"
        )

    @property
    def where(self) -> str:
        """Place of the largest residual; a run is named only if there are several."""
        run = f"run {self.worst_run}, " if len(self.by_run) > 1 else ""
        return f"{run}channel {self.worst_channel}"

    def judged(self, uncertain: float, threshold: float | None = None) -> "GoodnessOfFit":
        """Return the record for a floor known within a factor, and the threshold of the log."""
        return replace(self, uncertain=uncertain, threshold=threshold or WORTH_REPORTING)

    def to_dict(self) -> dict[str, Any]:
        """Return the record of calib.json and `--json`."""
        stored = {name: value for name, value in vars(self).items() if name not in ("by_run", "by_channel")}
        return {
            "statement": self.sentence,
            "material": self.material,
            "significant": self.significant,
            "scatter": self.scatter,
            "limit": self.limit,
            **stored,
            "by_run": {str(run): value for run, value in self.by_run.items()},
            "by_channel": dict(self.by_channel),
        }


def limit_of(uncertain: float, threshold: float) -> float:
    """Return the multiple of a noise floor up to which nothing is worth reporting, of a fit or a diagnosis.

    `uncertain`: factor within which the floor is known, beside the 3 % of a stated one.
    """
    return uncertain * (1 + KNOWN) / (1 - threshold)


def goodness_of(point: Point, estimated: int) -> GoodnessOfFit:
    """Return the goodness of fit at a point, of whose parameters `estimated` were fitted to these runs."""
    cost, summary = point.cost, point.cost.summary
    channels, offsets = summary.model.channels, len(summary.model.offsets)
    used = np.flatnonzero(cost.weights > 0)
    counts = (cost.weights * summary.counts)[used]
    squares = np.einsum("rkk->rk", point.squares)[used] * cost.weights[used, None]
    relative = squares / np.einsum("rkk->rk", point.covariance)[used]
    K = len(channels)
    dof = max(float(counts.sum()) * K - estimated - offsets * len(used), 1.0)
    # a run's offsets are estimated from it alone, the parameters from all runs
    cell = np.maximum(counts - offsets / K - estimated * counts / (K * max(counts.sum(), 1.0)), 0.5)[:, None]
    ratio = relative / cell
    coloured = _inflation(ratio, cell)
    independent = np.maximum(cell / coloured, 1.0)
    least = ratio * independent / chdtri(independent, CHANCE / ratio.size)
    run, channel = np.unravel_index(int(np.argmax(least)), least.shape)
    by_run = np.sqrt(point.run_values[used] * cost.weights[used] / (K * cell[:, 0]))
    return GoodnessOfFit(
        residual_over_noise=residual_over_floor(point) * float(np.sqrt(counts.sum() * K / dof)),
        cost_per_degree_of_freedom=point.value / dof,
        degrees_of_freedom=max(dof / coloured, 1.0),
        by_run=dict(zip((summary.runs[r] for r in used), by_run.tolist(), strict=True)),
        by_channel=dict(zip(channels, np.sqrt(relative.sum(axis=0) / cell.sum()).tolist(), strict=True)),
        worst_run=summary.runs[used[run]],
        worst_channel=channels[channel],
        worst=float(np.sqrt(ratio[run, channel])),
        worst_least=float(np.sqrt(least[run, channel])),
    )


def _inflation(ratio: np.ndarray, cell: np.ndarray) -> float:
    """Variance of the cost of a channel in a run over that of white noise, 1 or more.

    `ratio`: (r, K) mean squares over the noise's, `cell`: (r, 1) their degrees of freedom. Coloured noise has
    fewer independent samples than samples, in every run; the median ignores runs that are wrong.
    """
    usual = np.maximum(np.median(ratio, axis=0), 1e-300)
    spread = (ratio / usual - 1.0) / np.sqrt(2.0 / cell)
    return max(1.0, float(MAD * np.median(np.abs(spread))) ** 2)


def diagnose_command(path: object, model: Model, effects: Sequence[str]) -> str:
    """Return the command that finds the cause; a call in Python where the log came from no file."""
    if path is None:
        return f'hallsym.diagnose(log, "{model.name}")' if not effects else "hallsym.diagnose(log, fit)"
    added = [word for effect in effects for word in ("--effect", effect)]
    return shlex.join(["hallsym", "diagnose", str(path), "--model", model.name, *added])


def _times(multiple: float) -> str:
    return f"{multiple:.0f} times" if multiple >= 10 else f"{multiple:.2g} times"


# -- the noise floor: what noise, or a residual, adds to the error of the decoded pose ---------------------


def uncertain(point: Point, noise: Noise, length_scale_m: float | None) -> float:
    """Return the factor within which the noise floor is known, as the pose metric weighs coordinates.

    Each column counts by its contribution to the error.
    """
    known = {c: s.uncertain for c, s in noise.sigmas.items()}
    model = point.cost.summary.model
    if len(factors := set(known.values())) == 1:
        return factors.pop()
    weights = model.family.pose_metric.weights(model.pose, length_scale_m)
    low, high = (float(np.linalg.norm(weights * floor)) for floor in _floors(point, {}, known))
    return high / low if low > 0 else max(known.values())


def noise_floor(point: Point) -> dict[str, float]:
    """RMSE of the decoded pose by reading and reference noise alone, by pose coordinate."""
    (floor,) = _floors(point, {})
    return dict(zip(point.cost.summary.model.pose, floor.tolist(), strict=True))


def _floors(point: Point, *factors: Mapping[str, float]) -> list[np.ndarray]:
    """Return the noise floor (n_pose,) for noise of columns that is larger than stated by `factors`."""
    D, share, poses, state = _gains(point)
    model, m, floors, J = point.cost.summary.model, len(D), [], None
    if model.typical:  # the covariance of a residual is not the same all over a run
        (flat,) = slopes_by_column(model)(point.p, poses, state)
        J = np.transpose(
            flat.reshape(len(point.cost.column_variance), len(model.channels), m, -1), (2, 3, 1, 0)
        )
    for each in factors:
        columns = (model.channels, (*model.references, *model.state))
        own, other = (np.array([each.get(c, 1.0) for c in names]) ** 2 for names in columns)
        reading, column = own * point.cost.reading_variance, other * point.cost.column_variance
        if J is not None:
            made = np.square(D) @ reading + np.square(D @ J) @ column
        else:
            cost = replace(point.cost, reading_variance=reading, column_variance=column) if each else None
            made = _decoded(D, cost.at(point.p).covariance if cost else point.covariance)
        floors.append(np.sqrt(np.einsum("r,mri->i", share / m, made)))
    return floors


def residual_over_floor(point: Point) -> float:
    """Return the decoded residual over its size by noise, as the pose metric weighs coordinates.

    Mean squares are over the number of samples, not the degrees of freedom, so a good fit is below 1.
    """
    cost, model = point.cost, point.cost.summary.model
    D, share, _, _ = _gains(point)
    left = point.squares / np.maximum(cost.summary.counts, 1.0)[:, None, None]
    weights = model.family.pose_metric.weights(model.pose, None)
    real, noise = (
        float(np.einsum("r,mri,i->", share, _decoded(D, S), weights**2)) for S in (left, point.covariance)
    )
    return float(np.sqrt(real / noise)) if noise > 0 else 1.0


def _decoded(D: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the variance of decoded coordinates, (m, r, n_pose), of readings with a covariance (r, K, K)."""
    return np.asarray(np.einsum("mrik,mrik->mri", D @ covariance, D))


def _gains(point: Point) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return d pose / d reading (m, r, n_pose, K) at m poses of r runs, the runs' shares, poses and state."""
    cost, summary, model = point.cost, point.cost.summary, point.cost.summary.model
    share = cost.weights * summary.counts / (cost.weights @ summary.counts)
    K, poses, m = len(model.channels), _poses(cost), max(len(model.typical), 1)
    state = np.tile(summary.mean_state.T, m)
    (flat,) = gain_at(model)(point.p, poses, state, 1.0 / cost.reading_variance)
    D = np.transpose(flat.reshape(K, len(model.pose), m, -1), (2, 3, 1, 0))
    return D, share, poses, state


def _poses(cost: Cost) -> np.ndarray:
    """Poses over which noise is averaged, (n_pose, m * runs): m typical ones, the zero pose without any.

    A coordinate that does not repeat, such as a gap on which the noise depends, is where each run was.
    """
    summary, model = cost.summary, cost.summary.model
    typical = np.array(model.typical or (np.zeros(len(model.pose)),))
    out = np.repeat(typical.T[:, :, None], len(summary.runs), axis=2)
    for k, coordinate in enumerate(model.pose):
        if summary.places and coordinate not in model.period:
            shares = (np.arange(len(typical)) + 0.5) / len(typical)
            out[k] = np.transpose([np.quantile(place[k], shares) for place in summary.places])
    return out.reshape(len(model.pose), -1)
