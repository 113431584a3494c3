"""`python -m hallsym` is `hallsym`."""

import sys

from hallsym.cli import main

sys.exit(main())
