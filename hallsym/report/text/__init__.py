"""What commands print: results as text for a terminal."""

from hallsym.report.text.budget import (
    along_text,
    budget_text,
    comparison_sentence,
    comparison_text,
    curve_cost_text,
    position_words,
    recorded_text,
)
from hallsym.report.text.plan import plan_text

__all__ = [
    "along_text",
    "budget_text",
    "comparison_sentence",
    "comparison_text",
    "curve_cost_text",
    "plan_text",
    "position_words",
    "recorded_text",
]
