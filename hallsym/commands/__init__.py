"""The commands of the command line, one file each: `add(sub)` describes it, `run(options)` carries it out."""

from hallsym.commands import demo, evaluate, fit, info, report, simulate

COMMANDS = (demo, fit, evaluate, report, info, simulate)
"""In the order of `hallsym --help`."""
