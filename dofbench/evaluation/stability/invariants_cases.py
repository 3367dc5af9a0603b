"""The invariants of every kernel, as one group of cases."""

from __future__ import annotations

from dofbench.evaluation.stability.invariants_blur import CASES as BLUR
from dofbench.evaluation.stability.invariants_likeness import CASES as LIKENESS
from dofbench.evaluation.stability.invariants_raster import CASES as RASTER

CASES = (*BLUR, *RASTER, *LIKENESS)
