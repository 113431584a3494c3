"""`python -m hallsym`: the installed command."""

import sys

from hallsym.cli.program import program

if __name__ == "__main__":
    sys.exit(program())
