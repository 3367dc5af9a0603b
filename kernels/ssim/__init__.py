"""Structural similarity as a training loss: `ssim` and `l1_ssim` in `reference.py` (torch) and `cpu.py` (numba)."""
