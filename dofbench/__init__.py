"""dofbench: datasets with a known lens, and a benchmark of depth-of-field-aware view synthesis."""

__version__ = "0.1.0"
