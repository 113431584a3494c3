"""The command line: one file a command, with its help page as docstring, a table of `OPTIONS`, and `run`."""

GROUPS = {
    "calibrate": {
        "capture": "lines of numbers from a serial port, as a log",
        "demo": "the paper's calibration on the bundled campaign",
        "info": "what a log, calibration or campaign file holds, or what a model is",
        "fit": "calibrate a model on a log",
        "fleet": "calibrate many devices: one row a device, and how they differ",
        "sort": "sensors by gain, in bins and in sets that an array decodes best with",
    },
    "understand": {
        "sensitivity": "what a log, or a plan, determines of each parameter",
        "diagnose": "where the gap lies, which effect causes it, how far it shrinks",
        "report": "one HTML page of a saved calibration",
    },
    "plan": {
        "plan": "choose what to record next, within your ranges and your time",
        "simulate": "write the log a known machine would record",
        "budget": "uncertainty of the decoded position, or any budget by the GUM",
        "tolerances": "which tolerance of the machine to tighten, or the error by known deviations",
        "trajectory": "a curve through points or of an expression, with the error it makes",
    },
    "use": {
        "evaluate": "errors of a saved calibration on other logs, and whether they belong to it",
        "codegen": "C for the controller",
        "export": "the correction table of a maker's firmware",
    },
}
"""Each command by task, as `hallsym --help` lists them; the file of one is read when it is called."""
COMMANDS = {name: what for group in GROUPS.values() for name, what in group.items()}

OK, CHANGED, BAD_INPUT, NOT_DETERMINED, NOT_CONVERGED, BUG, INTERRUPTED = 0, 1, 2, 3, 4, 70, 130
NOT_DESCRIBED = NOT_DETERMINED
"""Exit codes, as `hallsym --help` explains them: 3 is done, but not to be used without a second look;
1 is the answer of `evaluate` that a log does not belong to its calibration."""
