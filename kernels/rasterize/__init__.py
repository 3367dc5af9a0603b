"""Rasterising 3D Gaussians: colour, opacity, depth and normals of one view, with gradients."""
