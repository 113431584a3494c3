"""The commands of the command line, one file each: `add(sub)` describes it, `run(options)` carries it out."""

from hallsym.commands import budget, demo, evaluate, fit, info, plan, sensitivity, simulate, tolerances

COMMANDS = (demo, fit, evaluate, budget, sensitivity, plan, tolerances, info, simulate)
"""In the order of `hallsym --help`."""
