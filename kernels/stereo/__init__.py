"""Plane-sweep stereo: `stereo`, `upsample` and `semiglobal` in `reference.py` (torch) and `cpu.py` (numba)."""
