"""The commands of the command line, one file each: `add(sub)` describes it, `run(options)` carries it out."""

from hallsym.commands import (
    budget,
    codegen,
    demo,
    diagnose,
    evaluate,
    fit,
    info,
    plan,
    report,
    selftest,
    sensitivity,
    simulate,
    tolerances,
    trajectory,
)

COMMANDS = (
    demo,
    fit,
    evaluate,
    diagnose,
    selftest,
    report,
    sensitivity,
    budget,
    codegen,
    plan,
    tolerances,
    simulate,
    trajectory,
    info,
)
"""In the order of `hallsym --help`."""
