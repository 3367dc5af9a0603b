"""`python -m dofbench` is the command `dofbench`."""

import sys

from dofbench.cli import main

if __name__ == "__main__":  # spawned workers import this module and must not start over
    sys.exit(main())
