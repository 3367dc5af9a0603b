"""`dofbench fetch`: download the scenes of a named dataset to where `dofbench scenes` finds them."""

from dofbench.datasets.fetching.fetch import fetch

__all__ = ["fetch"]
