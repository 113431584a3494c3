"""The installed command `hallsym`: loaded first, so that Ctrl-C is one sentence from then on."""

import signal
import sys
import warnings
from collections.abc import Sequence
from types import FrameType


def program(arguments: Sequence[str] | None = None) -> int:
    """Run the command line as a person does: Ctrl-C at any moment is one sentence, libraries do not warn.

    `arguments`: of the command, those of the process by default.
    """
    interrupted = []

    def interrupt(number: int, frame: FrameType | None) -> None:
        interrupted.append(number)
        raise KeyboardInterrupt

    try:
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where it is ignored (nohup)
            signal.signal(signal.SIGINT, interrupt)
        if not sys.warnoptions:
            warnings.simplefilter("ignore")
        from hallsym.cli.main import main

        return main(arguments, interrupted=lambda: bool(interrupted))
    except KeyboardInterrupt:  # while the command line itself was loaded
        sys.stderr.write("hallsym: interrupted; nothing was written.\n")
        return 130
