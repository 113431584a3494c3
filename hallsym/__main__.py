"""`python -m hallsym` is `hallsym`."""

import sys

from hallsym.cli.main import main

sys.exit(main())
