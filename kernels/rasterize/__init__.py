"""Rasterising 3D Gaussians: `rasterize` and `rasterize_from_points`."""
