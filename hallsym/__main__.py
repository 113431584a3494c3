"""The installed command `hallsym`, and `python -m hallsym`."""

import signal
import sys
import warnings
from types import FrameType


def program() -> int:
    """Run the command line as a person does: Ctrl-C at any moment is one sentence, libraries do not warn."""
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

        return main(interrupted=lambda: bool(interrupted))
    except KeyboardInterrupt:  # while the command line itself was loaded
        sys.stderr.write("hallsym: interrupted; nothing was written.\n")
        return 4


if __name__ == "__main__":
    sys.exit(program())
