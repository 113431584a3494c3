"""Two models on the same log: which parameters one determines and the other does not, and by how much."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hallsym.inference.report import Identifiability
from hallsym.report.tables import concise, grid


def compared(report: Identifiability, others: Sequence[Identifiability]) -> list[dict[str, Any]]:
    """Return one record per other model: rank, cost, verdict and standard uncertainty by parameter."""
    return [
        {
            "model": other.model.name,
            "rank": other.structural.rank,
            "of": other.structural.of,
            "cost": float(other.evidence.cost.at(other.evidence.p).value),
            "cost_here": float(report.evidence.cost.at(report.evidence.p).value),
            "parameters": {
                entry.name: {
                    "verdict": entry.verdict.word,
                    "std": entry.std,
                    "verdict_here": _word(report, entry.name),
                    "std_here": _std(report, entry.name),
                }
                for entry in other.parameters
            },
        }
        for other in others
    ]


def beside_text(report: Identifiability, others: Sequence[Identifiability]) -> str:
    """Return verdict and value of each parameter under every model, side by side."""
    every = [report, *others]
    names = list(dict.fromkeys(entry.name for one in every for entry in one.parameters))
    rows = [["parameter", *(one.model.name for one in every)]]
    rows += [[name, *(_cell(one, name) for one in every)] for name in names]
    rank = [f"{one.structural.rank} of {one.structural.of}" for one in every]
    cost = [f"{one.evidence.cost.at(one.evidence.p).value:.6g}" for one in every]
    return grid([*rows, ["structural rank", *rank], ["cost (-2 log likelihood)", *cost]])


def _cell(report: Identifiability, name: str) -> str:
    if name not in report.model.names:
        return "-"
    entry = report[name]
    factor, unit = (180 / np.pi, "deg") if entry.unit == "rad" else (1.0, entry.unit)
    if entry.std is None:
        return entry.verdict.word
    return f"{concise(entry.value * factor, entry.std * factor)} {unit}"


def _word(report: Identifiability, name: str) -> str | None:
    return report[name].verdict.word if name in report.model.names else None


def _std(report: Identifiability, name: str) -> float | None:
    return report[name].std if name in report.model.names else None
