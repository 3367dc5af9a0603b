"""What methods share to train: Gaussians, fields and what both use."""
