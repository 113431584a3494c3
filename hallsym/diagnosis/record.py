"""What a diagnosis says, as data: frozen, and JSON as documented."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

Gap = Mapping[str, Mapping[str, float]]
"""`{"rmse": {"x_m": ..}, "peak": {..}}` on the held-out runs."""


@dataclass(frozen=True)
class Estimate:
    """A parameter of an effect: value and standard uncertainty in SI; None where there is none to give."""

    value: float
    std: float | None
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """An effect that lowers the gap, with all others of the list in place.

    `shrinkage`: 1 - gap with it / gap without it, on the held-out runs, and its 95 % interval from resampled
    blocks. `share`: part of the gap above the noise floor that it closes. `p_value`: of its absence, honest
    for correlated residuals and corrected for the size of the catalogue. `cost`: what it adds to the model.
    `text`: what `--effect` takes to fit it, empty for faults of the recording. `at_bound`: parameters that
    ended at a bound; they have no uncertainty, and `note` says so. `note` also says what to do about a fault.
    """

    name: str
    link: str
    variant: str
    parameters: dict[str, Estimate]
    p_value: float
    shrinkage: float
    interval: tuple[float, float]
    share: float
    cost: str
    text: str = ""
    at_bound: tuple[str, ...] = ()
    note: str = ""


@dataclass(frozen=True)
class Statement:
    """Where the gap lives: `share` of the excess above the noise floor that goes with `by` (at `at`).

    `share`: 0 to 1, on fitted runs; statements on coordinates count only what those before leave, so that
    their shares add up to at most 1. `held_out`: the same on held-out runs, with what was fitted on the
    others; None where it is not asked. `kind`: as of `Share`; of a frequency "mains", "motion" or "band". Of
    a coordinate: its `unit`, the `period` of ripples or of a place within a period, the `waves` per period
    and the `sensor` that sees it above all. JSON holds the first six; `text` says the rest.
    """

    by: str
    at: str
    share: float
    p_value: float
    text: str
    held_out: float | None = None
    kind: str = "coordinate"
    unit: str | None = None
    period: float | None = None
    waves: tuple[int, ...] = ()
    sensor: str | None = None


IN_WORDS = ("kind", "unit", "period", "waves", "sensor")
"""Fields of a statement that its JSON has in `text` only."""


@dataclass(frozen=True)
class Share:
    """What one coordinate, link, output, sensor, frequency or run takes of the excess by itself.

    `kind`: "coordinate", "link", "output", "sensor", "frequency" or "run". `share`: 0 to 1 on fitted runs;
    shares of different rows overlap. None where it cannot be said, then `text` says why. `p_value`: of no
    such share, all that was tried counted; above 0.01 a share is no evidence. `text`: what it rests on.
    """

    kind: str
    name: str
    share: float | None
    p_value: float | None
    text: str = ""


@dataclass(frozen=True)
class Separation:
    """The recording that would tell the members of a group apart, and by how much.

    `distance`, `needed`: whitened squared distance between what the members leave on this log, and the one
    that 5 sigma take; `factor`: how many times larger the difference must be, sqrt(needed / distance).
    `simulated`: whether `recording` comes from the members' own models; then one such run of `run_s` seconds
    adds `sigma` standard deviations to the `sigma_now` of this log, and `runs` of them (`seconds` in all)
    reach 5. `tried`: every simulated recording, with its sigma per run. Where no recording can be simulated,
    or none separates, `recording` is what the catalogue says.
    """

    group: tuple[str, ...]
    recording: str
    distance: float
    needed: float
    factor: float
    simulated: bool = False
    sigma_now: float | None = None
    sigma: float | None = None
    run_s: float | None = None
    runs: int | None = None
    seconds: float | None = None
    tried: dict[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Waves:
    """Amplitude of the wave of error that repeats `per_turn` times per period of a coordinate, over all runs.

    `designed`: of the nominal sensor, only its zeros fitted; `model`: of the diagnosed model; `after`: with
    the effects that were found, None where there are none. SI. `causes`: effects of the catalogue that make
    so many waves. `coordinate`: of a pose of several coordinates, the one that is periodic.
    """

    per_turn: int
    designed: float
    model: float
    after: float | None
    causes: tuple[str, ...]
    coordinate: str = ""

    @property
    def absorbed(self) -> bool:
        """Whether the model's own parameters take up most of it, so that no effect can be told from them."""
        return self.model < 0.5 * self.designed


@dataclass(frozen=True)
class Diagnosis:
    """The answer of `diagnose`: verdict, where, which, how far the gap shrinks. SI units throughout.

    `noise_floor`: `{"x_m": .., "source": "stated" or "estimated"}`. `ranked`: names that carry evidence, best
    first. `groups`: names that this log cannot tell apart. `metric`: the scalar gap metric [m] before,
    after, and of the floor. `smaller_findings`: significant but not worth the threshold. `remaining`: where
    what no effect explains lies. `unexplained`: its share of the gap, what it goes with and how, see `shape`;
    empty unless that is the verdict. `size`: how large the gap is, per output and per sensor, on fitted and
    on held-out runs, see `size.sizes`. `shares`: what each coordinate, link, output, sensor, frequency and
    run takes of the excess by itself; empty where noise explains it.
    `next_step`: what `hallsym fit LOG` takes to fit the model with the effects found; empty without any.
    `waves`: of each periodic coordinate, its error by waves per period.
    """

    verdict: str
    sentence: str
    noise_floor: dict[str, Any]
    gap_before: Gap
    gap_after: Gap
    metric: dict[str, float]
    shrinkage: dict[str, Any]
    ranked: tuple[str, ...]
    groups: tuple[tuple[str, ...], ...]
    effects: tuple[FoundEffect, ...]
    where: tuple[Statement, ...]
    remaining: tuple[Statement, ...]
    separate_by: tuple[Separation, ...]
    validation_runs: tuple[int, ...]
    not_testable: dict[str, str]
    smaller_findings: tuple[dict[str, Any], ...]
    threshold: float
    model: str
    log: dict[str, Any]
    notes: tuple[str, ...] = ()
    seconds: float = 0.0
    versions: dict[str, str] = field(default_factory=dict)
    unexplained: dict[str, Any] = field(default_factory=dict)
    size: dict[str, Any] = field(default_factory=dict)
    shares: tuple[Share, ...] = ()
    next_step: tuple[str, ...] = ()
    waves: tuple[Waves, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Return the diagnosis as plain JSON data."""
        record: dict[str, Any] = _plain(asdict(self))
        for wave in record["waves"]:
            if not wave["coordinate"]:
                del wave["coordinate"]
        for statement in (*record["where"], *record["remaining"]):
            for name in IN_WORDS:
                del statement[name]
        return record


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, float):
        return value if value == value and abs(value) != float("inf") else None
    if hasattr(value, "item"):
        return _plain(value.item())
    return value
