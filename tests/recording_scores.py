"""Judge what a fit says of a recording whose mistake is known: noticed, named, silent, or wrong.

A correction is compared with the right ones by what it does, not by its letters: a unit is its factor, a step
of the gain is a factor, runs are nearly the same runs. The harm of a mistake is the error that a calibration
made from the mistaken log decodes on the healthy one, over the noise floor of the pose.
"""

from __future__ import annotations

import contextlib
import io
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from time import process_time

import numpy as np
from recordings import HEALTHY, Mistaken, Recording, Size, healthy, kept, mean_of, mistaken, shifted

import hallsym
from hallsym.cli.fit import exit_code
from hallsym.errors import InputError
from hallsym.units import UNITS

HARMED = 3.0
"""Decoded error over the floor from which on a mistake harms its user."""

MOSTLY = 0.75
"""Share of the runs that two corrections have in common, of all that either has, where they mean the same."""
ENOUGH = 3000
"""Samples from which the rms of an error is known."""

# -- corrections -------------------------------------------------------------------------------------------

_RUNS = re.compile(r"\d+(-\d+)?(,\d+(-\d+)?)*")


@dataclass(frozen=True)
class Correction:
    """A correction, read from its text."""

    name: str
    columns: frozenset[str]
    numbers: tuple[float, ...]
    runs: frozenset[int] = frozenset()


def run_numbers(text: str) -> frozenset[int]:
    """Return the runs of `3,5,7-9`."""
    ends = [part.split("-") for part in text.split(",")]
    return frozenset(k for e in ends for k in range(int(e[0]), int(e[-1]) + 1))


def correction(text: str) -> Correction:
    """Read a correction, such as `scale x_ref_m mm in 3,5`; a unit becomes the factor to multiply by."""
    name, *words = text.split()
    runs: frozenset[int] = frozenset()
    if len(words) > 1 and words[-2] == "in" and _RUNS.fullmatch(words[-1]):
        runs, words = run_numbers(words[-1]), words[:-2]
    if name == "exchange":
        return Correction(name, frozenset(words), (), runs)
    columns = frozenset(words[0].split(",")) if words else frozenset()
    numbers = tuple(_number(w) for w in words[1:] if w != "from")
    if name == "gain_step":
        name, numbers = "scale", (1 / numbers[0],)
    if name == "zero_moved" and len(numbers) == 1:
        numbers = (*numbers, 0.0)
    return Correction(name, columns, numbers, runs)


UNIT = {"in": 0.0254, "inch": 0.0254, "dm": 0.1, "um": 1e-6}


def _number(word: str) -> float:
    if word in UNITS:
        return UNITS[word].factor
    return UNIT[word] if word in UNIT else float(word)


def _near(
    name: str, given: Sequence[float], right: Sequence[float], r: Recording, columns: frozenset
) -> bool:
    """Whether the numbers of two corrections of one name mean the same."""
    if len(given) != len(right) and (given or name != "stuck"):
        return False
    a, b = np.array(given, float), np.array(right, float)
    if name in ("scale", "coarse_steps"):
        return bool(np.all(np.abs(a / b - 1) < (0.01 if name == "scale" else 0.1)))
    if name == "delay":
        return bool(np.all(np.abs(a - b) <= 0.5))
    if name == "zero_moved":
        early = max(3, 0.05 * len(r.true["run"]) / len(r.runs))
        return bool(abs(a[0] / b[0] - 1) < 0.2 and abs(a[1] - b[1]) <= early)
    if name == "stuck" and not given:
        return True
    if name == "stuck":
        both, either = min(a[1], b[1]) - max(a[0], b[0]), max(a[1], b[1]) - min(a[0], b[0])
        return bool(both / either > 0.7)
    if name == "clipped":
        span = max(np.ptp(r.true[c]) for c in columns)
        finite = np.isfinite(b)
        return bool(np.all(np.abs(a[finite] - b[finite]) < 0.03 * span))
    return bool(np.all(a == b))


def same(text: str, right: str, r: Recording) -> bool:
    """Whether a correction does what a right one does, nearly; of some runs, it may be of a part of them."""
    try:
        a, b = correction(text), correction(right)
    except (ValueError, KeyError, IndexError):
        return False
    if (a.name, a.columns) != (b.name, b.columns) or not _near(a.name, a.numbers, b.numbers, r, a.columns):
        return False
    if a.name == "stuck" and not a.numbers:  # it leaves out what repeats, where that is
        return a.runs <= b.runs
    shared = len(a.runs & b.runs) / max(1, len(a.runs | b.runs))
    return a.runs == b.runs or (len(a.runs) > 0 and a.runs < b.runs) or shared >= MOSTLY


def repeated(x: np.ndarray, shortest: int = 8) -> np.ndarray:
    """Return which samples are in a row of values that the column held before."""
    known, out = set(), np.zeros(len(x), bool)
    for k in range(len(x) - shortest + 1):
        row = x[k : k + shortest].tobytes()
        out[k : k + shortest] |= row in known
        known.add(row)
    return out


def undone(r: Recording, text: str) -> Recording:
    """Return a log as a correction makes it, done here in numpy: what hallsym makes of it is not asked.

    Samples that cannot be put right are left out: those at a limit and at the ends of a delayed run.
    """
    it, arrays, stated = correction(text), {c: x.copy() for c, x in r.arrays.items()}, dict(r.stated)
    keep, numbers = np.ones(len(r.true["run"]), bool), it.numbers
    every = [*r.readings, *r.references, *r.state]
    if it.name in ("copied_run", "other_device"):
        return kept(r, ~np.isin(r.arrays["run"], list(it.runs)))
    for run in it.runs or r.runs.tolist():
        rows = r.rows(run)
        at = np.arange(rows.stop - rows.start)
        if it.name == "exchange":
            one, two = it.columns
            arrays[one][rows], arrays[two][rows] = r.arrays[two][rows], r.arrays[one][rows]
        elif it.name == "averaged":
            for c in set(every) - it.columns:
                arrays[c][rows] = mean_of(arrays[c][rows], int(numbers[0]))
        elif it.name == "stuck":
            keep[rows] &= (at < numbers[0]) | (at >= numbers[1]) if numbers else \
                ~np.any([repeated(r.arrays[c][rows]) for c in it.columns], axis=0)  # fmt: skip
        for c in it.columns:
            if it.name in ("sign", "scale"):
                arrays[c][rows] *= -1 if it.name == "sign" else numbers[0]
            elif it.name == "zero_moved":
                arrays[c][rows] -= numbers[0] * (at >= numbers[1])
            elif it.name == "delay":
                arrays[c][rows] = shifted(arrays[c][rows], -int(numbers[0]))
                keep[rows] &= (at >= -numbers[0]) & (at < len(at) - numbers[0])
            elif it.name == "clipped":
                keep[rows] &= (arrays[c][rows] > numbers[0]) & (arrays[c][rows] < numbers[1])
    if it.name == "coarse_steps":
        step = numbers[0] / np.sqrt(12)
        stated |= {c: float(np.hypot(stated[c], step)) for c in it.columns if c in stated}
    return kept(replace(r, arrays=arrays, stated=stated), keep)


# -- harm --------------------------------------------------------------------------------------------------


def decoded_errors(fit, r: Recording, arrays) -> np.ndarray:
    """Return the systematic error of the decoded pose over its floor, rms by coordinate (pose,).

    `arrays`: the readings and the state that the calibration is given; the pose is known from `r.true`, the
    noise is that of `r.sigma`. A constant error of each run is taken out where runs have zeros of their own.
    """
    thin = slice(None, None, max(1, len(r.true["run"]) // ENOUGH))
    arrays, true = ({c: x[thin] for c, x in given.items()} for given in (arrays, r.true))
    model = fit.model
    state = [arrays.get(c, np.zeros(len(arrays["run"]))) for c in model.state]
    wired = fit.assignment or [(c, 1) for c in model.channels]
    seen = np.array([sign * arrays[c] for c, sign in wired])
    weight = 1 / np.array([r.sigma[c] for c in model.channels])[:, None]
    turns = [k for k, c in enumerate(model.channels) if c in model.period]

    def read(pose: np.ndarray) -> np.ndarray:
        return weight * model.readings(fit.values, pose, state)

    def rest(pose: np.ndarray) -> np.ndarray:
        left = weight * seen - read(pose)
        left[turns] = weight[turns] * np.angle(np.exp(1j * left[turns] / weight[turns]))
        return left

    truth = np.array([true[c] for c in model.references])
    runs = [true["run"] == run for run in np.unique(true["run"])] if model.offsets else []
    pose = truth.copy()
    if runs and model.pose[0] in model.period:  # each run begins where its own zero is
        tried = np.linspace(0, model.period[model.pose[0]], 24, endpoint=False)
        cost = np.array([np.sum(rest(truth + at) ** 2, axis=0) for at in tried])
        for rows in runs:
            pose[:, rows] += tried[np.argmin(cost[:, rows].sum(axis=1))]
    steps = [1e-7 if c.endswith("_m") else 1e-6 for c in model.references]
    for _ in range(4):
        now = read(pose)
        slopes = [(read(pose + h[:, None]) - now) / h.max() for h in np.diag(steps)]
        a = np.array(slopes).transpose(2, 1, 0)
        pose = pose + (np.linalg.pinv(a) @ rest(pose).T[:, :, None])[:, :, 0].T
    floor = np.sqrt(np.mean(np.linalg.pinv(a.transpose(0, 2, 1) @ a).diagonal(axis1=1, axis2=2), axis=0))
    error = pose - truth
    for rows in runs:
        error[:, rows] -= error[:, rows].mean(axis=1, keepdims=True)
    return np.sqrt(np.mean(error**2, axis=1)) / floor


def harm(fit, r: Recording, arrays) -> float:
    """Return the largest decoded error over its floor, the noise of the readings counted; inf if none is."""
    try:
        with np.errstate(all="ignore"):
            worst = np.nanmax(decoded_errors(fit, r, arrays))
    except np.linalg.LinAlgError:
        return np.inf
    return float(np.hypot(1, worst))


# -- one case ----------------------------------------------------------------------------------------------


@dataclass
class Outcome:
    """What came of a case.

    `ends`: "refusal", or the exit code. `harm`: of the calibration on healthy readings; `own`: on the columns
    as they were recorded, where a controller that reads the same would use it; None where nothing was fitted.
    `verdict`: as the function of that name says; of a healthy log false, noted or ok.
    """

    case: str
    kind: str
    family: str
    right: tuple[str, ...]
    ends: str
    harm: float | None
    own: float | None
    first: str | None
    claims: list[dict]
    said: str
    seconds: float
    verdict: str = ""


def told(r: Recording):
    """Fit a recording -> (fit, or the refusal; how it ends; what is said; seconds)."""
    began = process_time()
    try:
        fit = hallsym.fit(r.log, r.model, effects=r.effects, parameters=r.parameters, solver="direct")
    except InputError as error:
        return error, "refusal", str(error), process_time() - began
    with contextlib.redirect_stderr(io.StringIO()) as out:
        code = exit_code(fit)
    amiss = (fit.goodness and fit.goodness.sentence) or ""
    return fit, str(code), " | ".join(x for x in (out.getvalue(), amiss, *fit.notes) if x), (
        process_time() - began
    )  # fmt: skip


def judged(kind: str, family: str, seed: str, size: Size | None = None) -> Outcome:
    """Make a case, mistaken or healthy, fit it, and judge what is said of it."""
    if kind in HEALTHY:
        return judged_healthy(f"{kind}/{family}/{seed}", kind, healthy(kind, family, seed))
    return judged_mistake(mistaken(kind, family, seed, size))


def judged_mistake(m: Mistaken) -> Outcome:
    """Fit a mistaken log and judge what is said of it."""
    fit, ends, said, seconds = told(m.recording)
    claims = [asdict(one) for one in getattr(fit, "claims", ())]
    first = next((c["correction"] for c in claims if c["correction"]), None)
    r = m.recording
    healthy = {**r.true}
    recorded = {c: r.arrays[c] if c in m.columns else x for c, x in r.true.items()}
    hurt = own = None
    if ends != "refusal":
        hurt = harm(fit, r, healthy)
        own = hurt if m.runs else harm(fit, r, recorded)
    out = Outcome(m.case, m.kind, r.family, m.right, ends, hurt, own, first, claims, said, seconds)
    out.verdict = verdict(m, out)
    return out


def heals(m: Mistaken, text: str) -> bool:
    """Whether a correction that was not foreseen makes a log that is described and calibrates without harm.

    One that leaves whole runs out would, of any mistake in them; it does not count. A mistake of the whole
    log is one of the controller's columns too, and corrected there as it is in the log.
    """
    r = m.recording
    if text.startswith(("other_device", "copied_run")):
        return False
    try:
        again = undone(r, text)
        fit, ends, *_ = told(again)
    except (ValueError, KeyError, IndexError):
        return False
    if ends != "0":
        return False
    recorded = {c: again.arrays[c] if c in m.columns else x for c, x in again.true.items()}
    same_columns = not m.runs and harm(fit, again, recorded) <= HARMED
    return same_columns or harm(fit, r, r.true) <= HARMED


def _in_range(rivals: Sequence[str], right: str) -> bool:
    """Whether rivals are scales of the same columns whose factors enclose the right one."""
    it, found = correction(right), [correction(text) for text in rivals]
    alike = [one for one in found if (one.name, one.columns, one.runs) == (it.name, it.columns, it.runs)]
    factors = [one.numbers[0] for one in alike if one.name == "scale"]
    return len(factors) > 1 and min(factors) <= it.numbers[0] <= max(factors)


def verdict(m: Mistaken, out: Outcome) -> str:
    """right | rival | equal | wrong: a correction is named; noticed: none; harmless | consistent | silent."""

    def is_right(text):
        return any(same(text, right, m.recording) for right in m.right)

    if m.legal:
        return "wrong" if out.first and not is_right(out.first) else "legal"
    if out.first:
        rivals = next((c["rivals"] or [] for c in out.claims if c["correction"] == out.first), [])
        if is_right(out.first):
            return "right"
        return "rival" if any(map(is_right, rivals)) else "equal" if heals(m, out.first) else "wrong"
    named = [text for c in out.claims for text in c["rivals"] or ()]
    if any(map(is_right, named)) or any(_in_range(named, right) for right in m.right):
        return "rival"
    if not m.right and any(set(c["columns"] or ()) & set(m.columns) for c in out.claims):
        return "right"
    if out.ends != "0" or out.claims:
        return "noticed"
    if out.harm <= HARMED:
        return "harmless"
    return "consistent" if out.own <= HARMED else "silent"


def judged_healthy(case: str, kind: str, r: Recording) -> Outcome:
    """Fit a healthy log; a claim with a correction, or a refusal, is false."""
    fit, ends, said, seconds = told(r)
    claims = [asdict(one) for one in getattr(fit, "claims", ())]
    first = next((c["correction"] for c in claims if c["correction"]), None)
    out = Outcome(case, kind, r.family, (), ends, None, None, first, claims, said, seconds)
    out.verdict = "false" if first or ends == "refusal" else "ok" if ends == "0" and not claims else "noted"
    return out


# -- rates -------------------------------------------------------------------------------------------------

FELT = ("right", "rival", "equal", "wrong", "noticed", "silent", "consistent")
"""Verdicts of mistakes that are neither harmless nor what another machine records."""


def rates(rows: Sequence[Outcome]) -> dict[str, float]:
    """Return numbers of cases, and shares of the mistakes that are felt and of the healthy logs.

    A right remedy among rivals that the log cannot tell apart is a right one; `first`: it is named alone, or
    before all others.
    """
    count = Counter(row.verdict for row in rows)
    healthy = count["ok"] + count["noted"] + count["false"]
    felt = sum(count[v] for v in FELT)

    def share(*verdicts):
        return sum(count[v] for v in verdicts) / max(1, felt)

    return {
        "mistakes": len(rows) - healthy, "felt": felt, "right": share("right", "rival", "equal"),
        "first": share("right"),
        "noticed": 1 - share("silent", "consistent"), "silent": share("silent"),
        "consistent": share("consistent"), "wrong": count["wrong"], "healthy": healthy,
        "false": count["false"] / max(1, healthy),
    }  # fmt: skip
