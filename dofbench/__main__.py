"""`python -m dofbench` is the command `dofbench`."""

from dofbench.cli import console

if __name__ == "__main__":  # spawned workers import this module and must not start over
    console()
