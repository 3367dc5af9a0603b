"""Radiance fields: a scene as density and colour in the unit cube, rendered along rays."""
