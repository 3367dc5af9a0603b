"""A radiance field on a factorised grid: `field`, `field_density`, `field_features` and `field_samples`."""
