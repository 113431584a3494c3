"""A twin: simulate the log that a model with known values would have recorded."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from hallsym.errors import InputError, require
from hallsym.families.cordic import MOST_STEPS, cordic_angle
from hallsym.model import Model
from hallsym.model.derived import Stretch
from hallsym.simulation.campaign import Campaign, Run

BLOCK = 65_536


@dataclass(frozen=True)
class NoiseModel:
    """Noise of the recorded columns.

    `sigma`: column -> standard deviation of white Gaussian noise in the column's unit. `correlation_s`: > 0
    makes the noise of all columns first-order autoregressive with that time constant, same variance.
    `degrees_of_freedom`: Student's t instead of Gaussian, scaled to the same variance (> 2).
    `outlier_share`, `outlier_size`: share of samples of each reading and reference that are off by a uniform
    error of up to +-size [the column's unit]. `cordic_steps`: a decoded angle is computed
    with so many steps of CORDIC (0: exactly); the noise acts before. `adc_step_m`: readings are rounded to
    it [their unit].
    """

    sigma: Mapping[str, float] = field(default_factory=dict)
    correlation_s: float = 0.0
    degrees_of_freedom: float | None = None
    outlier_share: float = 0.0
    outlier_size: float = 1e-3
    adc_step_m: float = 0.0
    cordic_steps: int = 0

    def __post_init__(self) -> None:
        """Refuse impossible levels."""
        for name, value in self.sigma.items():
            require(0 <= value < np.inf, f"Noise of {name}", "a number >= 0", value)
        for name in ("correlation_s", "outlier_size", "adc_step_m"):
            value = getattr(self, name)
            require(0 <= value < np.inf, f"Noise '{name}'", "a number >= 0", value)
        wanted = f"a whole number from 0 to {MOST_STEPS}"
        require(self.cordic_steps in range(MOST_STEPS + 1), "Noise 'cordic_steps'", wanted, self.cordic_steps)
        require(0 <= self.outlier_share <= 1, "Noise 'outlier_share'", "0 to 1", self.outlier_share)
        if self.degrees_of_freedom is not None and not self.degrees_of_freedom > 2:
            raise InputError("Student's t noise needs more than 2 degrees of freedom for a variance.")


def simulate(
    model: Model,
    values: Mapping[str, float],
    campaign: Campaign,
    noise: NoiseModel | None = None,
    *,
    seed: int,
) -> dict[str, np.ndarray]:
    """Return the columns of a simulated log (SI, `run` and `t_s` first), shape (rows,) each.

    `values`: parameter values of the twin over the model's nominal ones. The same seed gives the same log.
    For logs that do not fit in memory use `simulate_blocks`.
    """
    blocks = list(simulate_blocks(model, values, campaign, noise, seed=seed))
    return {name: np.concatenate([b[name] for b in blocks]) for name in blocks[0]}


def simulate_blocks(
    model: Model,
    values: Mapping[str, float],
    campaign: Campaign,
    noise: NoiseModel | None = None,
    *,
    seed: int,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the simulated log in blocks of one run each and at most 65 536 samples."""
    _check_axes(model, campaign)
    p, rng = model.vector(values), np.random.default_rng(seed)
    disturb = _Disturbance(model, noise or NoiseModel(), campaign.step_s, rng)
    made, start = {c.name for c in model.computed}, 0.0
    for number, run in enumerate(campaign.runs):
        offsets = _offsets(model, p, run, campaign, rng)
        total = campaign.samples(run)
        for first in range(0, total, BLOCK):
            t = np.arange(first, min(first + BLOCK, total)) * campaign.step_s
            pose = [run.position(c, t) for c in model.pose]
            logged = {c: run.position(c, t) for c in model.state if c not in made}
            known = {**dict(zip(model.references, pose, strict=True)), **logged, "t_s": start + t}
            state = logged | _computed(model, p, Stretch(number, known, start, 0.0, {}, {}))
            reading = model.readings(p, pose, [state[c] for c in model.state], offsets)
            columns = dict(zip((*model.channels, *logged), (*reading, *logged.values()), strict=True))
            columns |= dict(zip(model.references, pose, strict=True))
            yield {
                "run": np.full(len(t), number),
                "t_s": start + t,
                **{name: disturb(name, column) for name, column in columns.items()},
            }
        start += total * campaign.step_s + 1.0


def _computed(model: Model, p: np.ndarray, stretch: Stretch) -> dict[str, np.ndarray]:
    """Return the columns that are computed from others, as a fit computes them; 0 without their inputs."""
    none, out = np.zeros(len(stretch.data["t_s"])), {}
    for column in model.computed:
        taken = column.at(model.named(p)) if column.at else column
        out[column.name] = taken.rule(stretch) if set(taken.needs) <= set(stretch.data) else none
    return out


def _check_axes(model: Model, campaign: Campaign) -> None:
    """Refuse a campaign that moves what the model does not have."""
    own = (*model.pose, *model.state)
    for run in campaign.runs:
        for axis in (*run.setting, *run.motion):
            if axis not in own:
                raise InputError(f"A run moves {axis}, which {model.name} has not; it has {', '.join(own)}.")


def _offsets(
    model: Model, p: np.ndarray, run: Run, campaign: Campaign, rng: np.random.Generator
) -> np.ndarray:
    """Displacements d = delta / phi(0) of one run."""
    n = len(model.offsets)
    if n == 0:
        return np.zeros(0)
    delta = np.array(rng.normal(0.0, campaign.zero_spread_m, n) if run.offsets is None else run.offsets)
    require(len(delta) == n, "A run", f"one of {n} zero deviations, one per probe", len(delta))
    state = [run.position(c, np.zeros(1))[0] for c in model.state]
    return delta / model.zero_scale(p, np.array(state))  # (31): delta / phi(0)


class _Disturbance:
    """Adds noise column by column; keeps the state of correlated noise between blocks."""

    def __init__(self, model: Model, noise: NoiseModel, step_s: float, rng: np.random.Generator) -> None:
        known = (*model.channels, *model.state, *model.references)
        unknown = [c for c in noise.sigma if c not in known]
        if unknown:
            raise InputError(f"Noise is given for {unknown[0]!r}, which is no column of {model.name}.")
        self.noise, self.rng, self.channels = noise, rng, model.channels
        self.turns = {c: model.period[c] for c in model.channels if c in model.period}
        if noise.cordic_steps and not self.turns:
            raise InputError(
                f"Steps of CORDIC belong to a decoded angle; {model.name} reads {', '.join(model.channels)} "
                "here. A machine file with the probe angle_rad says so."
            )
        self.spiky = (*model.channels, *model.references)
        self.memory = float(np.exp(-step_s / noise.correlation_s)) if noise.correlation_s > 0 else 0.0
        self.last: dict[str, float] = {}

    def __call__(self, name: str, column: np.ndarray) -> np.ndarray:
        noise, sigma = self.noise, self.noise.sigma.get(name, 0.0)
        if sigma:
            column = column + sigma * self._unit(name, len(column))
        if noise.outlier_share and name in self.spiky:
            hit = self.rng.random(len(column)) < noise.outlier_share
            column = column + hit * self.rng.uniform(-noise.outlier_size, noise.outlier_size, len(column))
        if noise.cordic_steps and name in self.turns:
            turn = 2 * np.pi / self.turns[name]
            column = cordic_angle(np.sin(turn * column), np.cos(turn * column), noise.cordic_steps) / turn
        if noise.adc_step_m and name in self.channels:
            column = np.round(column / noise.adc_step_m) * noise.adc_step_m
        return np.mod(column, self.turns[name]) if name in self.turns else column

    def _unit(self, name: str, n: int) -> np.ndarray:
        dof = self.noise.degrees_of_freedom
        fresh = (
            self.rng.standard_normal(n)
            if dof is None
            else (self.rng.standard_t(dof, n) * np.sqrt((dof - 2) / dof))
        )
        if not self.memory:
            return fresh
        from scipy.signal import lfilter

        before = self.last.get(name, float(self.rng.standard_normal()))
        drive = fresh * np.sqrt(1 - self.memory**2)
        correlated, _ = lfilter([1.0], [1.0, -self.memory], drive, zi=[self.memory * before])
        self.last[name] = float(correlated[-1])
        return correlated
