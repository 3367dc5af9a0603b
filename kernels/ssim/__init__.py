"""The colour loss of a training: `ssim` and `l1_ssim` in `reference.py` (torch) and `cpu.py` (numba)."""
