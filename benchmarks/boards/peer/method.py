"""Views that another program rendered before, as a row like others."""

from dofbench import External


class Pictures(External):
    """Reads them from the folder that DOFBENCH_PEER names."""
