"""Plane-sweep stereo: `stereo`, `upsample`, `semiglobal` and `returns` in `reference.py` (torch), `cpu.py` (numba) and
`gpu.py` (Triton)."""
