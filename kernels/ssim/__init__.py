"""The colour loss of a training: `ssim` and `l1_ssim`."""
