"""The role of a dataset's scene, and the source of its defocus.

Presets are tuned on *tuning scenes* ("development" in files). On *test scenes* ("report" in files) only fixed presets
are run. Images blurred by the renderer that a method trains with flatter this method (an "inverse crime": Colton and
Kress, Inverse Acoustic and Electromagnetic Scattering Theory), so the source of the defocus is reported, and with it
which methods share its model.
"""

from __future__ import annotations

from typing import Literal

Role = Literal["development", "report"]
# The renderer of make-dataset; "light-field": real views, averaged; "unknown": the images came with the scene.
Photographer = Literal["light-field", "thinlens", "unknown", "layered", "scatter"]

ROLE_NOT_STATED = "not stated"
# Sentences by role; None where no named dataset states one.
ROLE_SAYS: dict[Role | None, str] = {
    "report": "Test scene: nothing was tuned on it; only presets fixed before were run.",
    "development": "Tuning scene: presets were chosen on it, so its scores don't show quality on other scenes.",
    None: "Role not stated: unknown whether anything was tuned on this scene.",
}
PHOTOGRAPHER_SAYS: dict[Photographer | None, str] = {
    "light-field": (
        "Real views, ideal lenses: averages of the views in round windows of a light field. Pixels and occlusion are "
        "real; the geometry is that of a thin lens, which methods with aperture samples (LensSelect, LensNeRF) train "
        "through too."
    ),
    "thinlens": (
        "Rendered with an ideal thin-lens camera: many rays a pixel through aperture samples and the scene's geometry. "
        "No method has this renderer, but methods with aperture samples (LensSelect, LensNeRF) train through the same "
        "model of a lens, which flatters them against a real one."
    ),
    "unknown": "Real defocus: the images came with the scene; their lenses are unknown.",
    "layered": (
        "Synthetic defocus (layered renderer): all-in-focus images blurred in layers by depth, with occlusion; not the "
        "forward model of DoF-Gaussian."
    ),
    "scatter": (
        "Synthetic defocus (scatter renderer): the forward model that DoF-Gaussian trains with, which flatters its "
        "scores and lens errors."
    ),
    None: "The source of the defocus isn't recorded.",
}
# Short forms, for titles.
ROLE_WORDS: dict[Role | None, str] = {"report": "test scene", "development": "tuning scene", None: ""}
PHOTOGRAPHER_WORDS: dict[Photographer | None, str] = {
    "light-field": "real defocus, known lenses (light field)",
    "thinlens": "ray-traced defocus",
    "unknown": "real defocus",
    "layered": "synthetic defocus (layered)",
    "scatter": "synthetic defocus (scatter)",
    None: "",
}
# The order in reports.
ROLES: tuple[Role | None, ...] = ("report", "development", None)
PHOTOGRAPHERS: tuple[Photographer | None, ...] = (
    "light-field",
    "thinlens",
    "unknown",
    "layered",
    "scatter",
    None,
)
