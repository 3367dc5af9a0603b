"""What scores on a dataset are evidence of: the role of its scene, and what took its photographs.

On a *development* scene anything may be tried, so its scores show what tuning has reached. On a *report* scene a preset
is run only after it was frozen. Photographs that were made by the blur model that a method trains through flatter that
method (an "inverse crime" in the words of Colton and Kress, Inverse Acoustic and Electromagnetic Scattering Theory), so
it is stated how they were made.
"""

from __future__ import annotations

from typing import Literal

Role = Literal["development", "report"]
# The renderer of make-dataset that took a dataset's photographs; "unknown": they came with the scene.
Photographer = Literal["thinlens", "unknown", "layered", "scatter"]

ROLE_NOT_STATED = "not stated"
# Sentences by role; None where no named dataset states one.
ROLE_SAYS: dict[Role | None, str] = {
    "report": "Report scene: nothing was tuned on it, and a preset is run on it only after it was frozen.",
    "development": (
        "Development scene: presets were chosen on it, so its figures show what tuning reached and are no evidence of "
        "quality on other scenes."
    ),
    None: "Role not stated: whether anything was tuned on this scene isn't known.",
}
PHOTOGRAPHER_SAYS: dict[Photographer | None, str] = {
    "thinlens": (
        "Photographed by a sampled lens: many rays a pixel from points of the lens, through the scene's own geometry, "
        "by a ray tracer that shares nothing with what the methods here render with."
    ),
    "unknown": ("Photographed by a lens of its own: the photographs came with the scene, and nobody knows their lens."),
    "layered": (
        "Photographed by a formula: blurred in layers from a sharp image and its depth, with occlusion. Not the "
        "forward model that DoF-Gaussian trains through, but no lens either."
    ),
    "scatter": (
        "Photographed by the scatter, the same forward model that DoF-Gaussian trains through; scores and lens errors "
        "are flattered by that."
    ),
    None: "How it was photographed isn't recorded.",
}
# The same in two words, for titles; those not stated add none.
ROLE_WORDS: dict[Role | None, str] = {"report": "report scene", "development": "development scene", None: ""}
PHOTOGRAPHER_WORDS: dict[Photographer | None, str] = {
    "thinlens": "sampled lens",
    "unknown": "unknown lens",
    "layered": "layers",
    "scatter": "scatter",
    None: "",
}
# The order in which reports show them: what is evidence first.
ROLES: tuple[Role | None, ...] = ("report", "development", None)
PHOTOGRAPHERS: tuple[Photographer | None, ...] = ("thinlens", "unknown", "layered", "scatter", None)
