"""Models on the same log: which parameters one determines and the other does not, and how certainly."""

from collections.abc import Sequence
from typing import Any

from hallsym.inference.identifiability import Identifiability


def comparison(report: Identifiability, others: Sequence[Identifiability]) -> list[dict[str, Any]]:
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


def _word(report: Identifiability, name: str) -> str | None:
    return report[name].verdict.word if name in report.model.names else None


def _std(report: Identifiability, name: str) -> float | None:
    return report[name].std if name in report.model.names else None
