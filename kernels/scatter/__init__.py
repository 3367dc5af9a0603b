"""Lens blur by scattering every pixel over its circle of confusion: `scatter`."""
