"""Twins of the paper's stage that several tests share, and its model typed a second time in numpy.

The numpy model follows the article's matrix PM and gain phi (Eq. (11), (14), (31)) for its own layout:
A at (+H1x, +H1y) and B at (-H2x, +H2y) sense Y, C at (+H3x, +H3y) senses X. It shares no code with
the package.
"""

from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from types import SimpleNamespace

import numpy as np
from msgspec import structs

from hallsym import bundled_campaign
from hallsym.estimation import Fit
from hallsym.estimation.factors import summarise
from hallsym.estimation.likelihood import Cost, cost_of
from hallsym.families import build, published
from hallsym.log import Block, Log, Noise, Sigma
from hallsym.model import Model
from hallsym.simulation import Campaign, NoiseModel, Run, campaign_from, paper_campaign, simulate
from hallsym.simulation.paper import VERTICAL_NOISE
from hallsym.simulation.signals import multi_sine

EPS = float(np.finfo(float).eps)
TRUTH = published.values("table7_estimates")
MODELS = ("stage15", "stage30", "stage31", "stage31_tied")
EFFECTS = ("zero_deviation", "vertical_coupling", "tied_vertical_coupling", "exact_rotation")
COLUMNS = ("x_ref_m", "y_ref_m", "rz_ref_rad", "z_m", "rx_rad", "ry_rad")
HALL = ("hall_a_m", "hall_b_m", "hall_c_m")
SIGMAS = {
    **dict.fromkeys(HALL, 0.5e-6),
    "x_ref_m": 1e-6,
    "y_ref_m": 1.4e-6,
    "rz_ref_rad": 0.5e-6,
} | VERTICAL_NOISE
"""About the noise of Table 8, with a reference that is noisy in Rz too."""


def combinations_of_effects() -> list[tuple[str, tuple[str, ...]]]:
    """Every model with every set of one or two effects that it does not have yet."""
    out = []
    for name in MODELS:
        model = build(name)
        new = [e for e in EFFECTS if e not in model.effects]
        if any("vertical_coupling" in e for e in model.effects):
            new = [e for e in new if "vertical_coupling" not in e]
        out += [(name, ()), *((name, (e,)) for e in new)]
        out += [(name, (e, "exact_rotation")) for e in new if e != "exact_rotation"]
    return out


def inside(model: Model, rng: np.random.Generator) -> np.ndarray:
    """Return a random parameter vector inside the bounds."""
    return rng.uniform(*model.bounds)


def pm(v: Mapping[str, float]) -> np.ndarray:
    """Return the matrix PM of Eq. (11)."""
    sA, cA = np.sin(v["theta_A"]), np.cos(v["theta_A"])
    sB, cB = np.sin(v["theta_B"]), np.cos(v["theta_B"])
    sC, cC = np.sin(v["theta_C"]), np.cos(v["theta_C"])
    return np.array(
        [
            [-sA, cA, v["H1x"] * cA + v["H1y"] * sA],
            [-sB, cB, v["H2y"] * sB - v["H2x"] * cB],
            [cC, sC, v["H3x"] * sC - v["H3y"] * cC],
        ]
    )


def phi(v: Mapping[str, float], state: np.ndarray) -> np.ndarray:
    """Return the gains of Eq. (31); without a, b, c those of Eq. (14). `state`: (3,) or (3, samples)."""
    return np.array(
        [
            v[f"eta_{k}"]
            + v.get(f"a_{k}", 0.0) * state[0]
            + v.get(f"b_{k}", 0.0) * state[1]
            + v.get(f"c_{k}", 0.0) * state[2]
            for k in "ABC"
        ]
    )


def phi_size(v: Mapping[str, float], state: np.ndarray) -> np.ndarray:
    """Return the sum of the sizes of the terms of phi: what its rounding errors are relative to."""
    return phi({name: abs(value) for name, value in v.items()}, np.abs(state))


def with_noise(columns: Mapping[str, np.ndarray], sigma: Mapping[str, float] = SIGMAS) -> Log:
    """Return a log that states its noise."""
    return Log.from_arrays(columns, noise=Noise({c: Sigma(s, "given") for c, s in sigma.items()}))


def altered(log: Log, **columns: np.ndarray) -> Log:
    """Return a log in which some columns are other ones."""
    return Log.from_arrays({c: log.array(c) for c in log.columns} | columns, log.noise, log.meta)


def simulated(
    model: Model, values: Mapping[str, float], plan: Campaign, sigma: Mapping[str, float], seed: int = 1
) -> Log:
    """Return the log of a machine of any model, with white noise of the size that it states.

    `values`: of parameters, those of the model are taken.
    """
    known = {n: v for n, v in values.items() if n in model.names}
    made = simulate(model, known, plan, NoiseModel(sigma), seed=seed)
    return Log.from_arrays(made, Noise.given(sigma, tuple(made)))


def example_log(model: Model, values: Mapping[str, float] | None = None, **plan: float) -> Log:
    """Return the log of the example of a model's family; `values`, `plan`: what is other than in it."""
    example = model.family.example
    noise = Noise.given(example.noise, (*model.channels, *model.references)).std
    known = {**example.values, **(values or {})}
    return simulated(model, known, campaign_from({**example.campaign, **plan}, "the example"), noise)


def swept(
    model: Model,
    values: Mapping[str, float],
    moves: Sequence[tuple[float, float, float, float, float, float]],
    sigma: float = 1e-3,
    reference: float = 1e-7,
) -> Log:
    """Return the log of a magnet array that is swept to and fro.

    `moves` of each run: seconds, amplitude [m] and frequency [Hz] of x and of the gap, and the mean gap [m].
    """
    runs = [
        {
            "duration_s": seconds,
            "x_m": {"kind": "sine", "amplitude": x, "frequency_hz": x_hz},
            "z_m": {"kind": "sine", "amplitude": z, "frequency_hz": z_hz, "about": gap},
        }
        for seconds, x, x_hz, z, z_hz, gap in moves
    ]
    noise = dict.fromkeys(model.channels, sigma) | {"x_ref_m": reference, "z_ref_m": reference}
    return simulated(model, values, campaign_from({"step_s": 8e-3, "run": runs}, "sweeps"), noise)


@cache
def campaign(samples: int = 50) -> Campaign:
    """Return the paper's 57 runs with few samples each."""
    return paper_campaign(step_s=1.0 / samples)


def truth_of(model: Model) -> dict[str, float]:
    """Return Table 7 for the parameters that the model has; the tied form's point from its own a, b, c."""
    known = {n: v for n, v in TRUTH.items() if n in model.names}
    if "tied_vertical_coupling" in model.effects:
        known |= {"x0": 0.12, "y0": -0.02}
    return known


def record(
    name: str = "stage31",
    *,
    seed: int,
    samples: int = 50,
    runs: int = 57,
    sigma: Mapping[str, float] = SIGMAS,
    **noise,
) -> dict[str, np.ndarray]:
    """Return the columns that a twin with Table 7's values records, of its first runs."""
    model = build(name)
    columns = simulate(model, truth_of(model), campaign(samples), NoiseModel(sigma, **noise), seed=seed)
    return {c: v[columns["run"] < runs] for c, v in columns.items()}


@cache
def exact(samples: int) -> dict[str, np.ndarray]:
    """Return what the twin of Model (31) records without noise."""
    return record(seed=0, samples=samples, sigma={})


def white(seed: int, samples: int = 50, sigma: Mapping[str, float] = SIGMAS) -> dict[str, np.ndarray]:
    """Return the same with white noise: a recording as of `record`, at a tenth of its cost."""
    rng = np.random.default_rng(seed)
    return {
        c: v + sigma[c] * rng.standard_normal(len(v)) if c in sigma else v for c, v in exact(samples).items()
    }


def true_model(name: str = "stage31") -> Model:
    """Return the model with Table 7's values as nominal ones, so that what is held stays at the truth."""
    model = build(name)
    return model.with_parameters({n: {"nominal": v} for n, v in truth_of(model).items()})


def cost_on(log: Log, model: Model, sigma: Mapping[str, float] = SIGMAS) -> Cost:
    """Return the likelihood of a log."""
    return cost_of(summarise(log, model), sigma)


class Chopped:
    """A log that streams: its blocks are handed over in pieces of the given sizes, in turn."""

    table = SimpleNamespace(in_memory=False)

    def __init__(self, log: Log, sizes: Sequence[int]) -> None:
        self.log, self.sizes, self.source = log, sizes, self

    def blocks(self, columns: Sequence[str], size: int = 65_536) -> Iterator[Block]:
        turn = 0
        for block in self.log.blocks(columns):
            n, first = len(next(iter(block.data.values()))), 0
            while first < n:
                last = first + self.sizes[turn % len(self.sizes)]
                yield Block(block.run, {c: v[first:last] for c, v in block.data.items()})
                first, turn = last, turn + 1


def same(one, other) -> None:
    """Two fits have the same optimum: values within 1e-6 standard deviations."""
    ok = one.determined
    assert np.array_equal(ok, other.determined)
    assert np.all(np.abs(one.values - other.values)[ok] < 1e-6 * one.std[ok])


def six_runs() -> Campaign:
    """Return six runs in which all axes move together, each at another vertical setting of Table 6."""
    settings = published.table("table6_settings")
    motion = {
        "x_m": multi_sine(300e-6, [1.0, 4.0]),
        "y_m": multi_sine(500e-6, [2.0, 5.0]),
        "rz_rad": multi_sine(300e-6, [3.0, 7.0]),
    }
    at = [{axis: settings[axis][k] for axis in ("z_m", "rx_rad", "ry_rad")} for k in (0, 4, 8, 12, 15, 18)]
    return Campaign(2e-3, tuple(Run(1.0, setting, motion) for setting in at))


def bundled(runs: slice) -> dict[str, np.ndarray]:
    """Return the columns of some runs of the bundled campaign."""
    log = bundled_campaign()
    run = log.array("run").astype(int)
    chosen = np.isin(run, log.runs[runs])
    return {c: run[chosen] if c == "run" else log.array(c)[chosen] for c in log.columns}


def with_arrays(fit: Fit, covariance: np.ndarray | None = None, **columns: np.ndarray) -> Fit:
    """A calibration with other arrays, such as `values` or `std`, in the order of its parameters."""
    parameters = fit.parameters
    for name, column in columns.items():
        key = "value" if name == "values" else name
        given = fit.model.named(column)
        parameters = {n: structs.replace(p, **{key: given[n]}) for n, p in parameters.items()}
    record = fit.covariance_record
    if covariance is not None:
        record = structs.replace(record, matrix=covariance.tolist())
    return fit.changed(parameters=parameters, covariance_record=record)
