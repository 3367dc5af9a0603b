"""`python -m dofbench` is the command `dofbench`."""

import sys

# `python -m` looks for modules in the current folder first, where a stranger's `random.py` may be. The folder is needed
# only where this package itself was found in it, in a checkout that isn't installed.
if __name__ == "__main__" and not sys.flags.safe_path and __file__ != f"{sys.path[0]}/dofbench/__main__.py":
    del sys.path[0]

from dofbench.cli.app import console

if __name__ == "__main__":  # spawned workers import this module and must not start over
    console()
