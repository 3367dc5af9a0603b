"""The options that lenses.json records beside the lenses: how a trained scene of Gaussians is rendered."""

from __future__ import annotations

# Options that a trained scene is rendered with, in the file's order.
RENDERING = (
    "sh_degree",
    "background",
    "filter_2d",
    "lens",
    "lens_model",
    "lens_rings",
    "lens_blades",
    "lens_rotation",
    "lens_gamma",
    "lens_alpha",
    "lens_energy",
)
NEAR_PLANE = "near"  # beside them: no option, but where the scene's near plane lies
CONVENTIONS = {
    "blur": "of colours raised to lens_gamma; lens_model scatter: each pixel of the sharp image is spread evenly over "
    "its disc, or polygon of lens_blades sides, with a rim of softness 1 / lens_alpha, its weight divided by "
    "the area unless lens_energy is algorithm1; lens_model samples: the scene as seen from points of the lens",
    "filter_2d": "pixels^2, added to every footprint's covariance, opacity times sqrt(det before / det after)",
    "near": "scene units: a Gaussian whose centre isn't farther than this in z isn't drawn",
    "background": "grey level behind the scene, encoded like the colours",
}
