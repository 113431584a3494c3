"""The commands of the command line, one file each: `add(sub)` describes it, `run(options)` carries it out."""

from hallsym.commands import (
    budget,
    demo,
    diagnose,
    evaluate,
    fit,
    info,
    plan,
    report,
    sensitivity,
    simulate,
    tolerances,
)

COMMANDS = (demo, fit, evaluate, diagnose, report, sensitivity, budget, plan, tolerances, simulate, info)
"""In the order of `hallsym --help`."""
