"""Lens blur by scattering every pixel over its circle of confusion (DoF-Gaussian, Algorithm 1)."""
