"""A radiance field on a factorised grid: `field` renders rays, `field_density` gives its density at points, and
`field_samples` says where rays meet occupied cells."""
