"""Scenes by make-scene: pinhole image, exact depth, and images through a real thin lens (`scene.json`)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file
from dofbench.core.images import image_size, read_exr, read_image
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.renderer.renderer_truth import Case, Truth
from dofbench.evaluation.renderer.sampled import has_geometry, thin_lens
from dofbench.optics.tone import encode

SCENE, SCHEMA = "scene.json", "dofbench-scene"
_NUMBERS = ("aperture", "focus", "aperture_scene", "focus_scene", "noise_psnr_db")


def is_rendered(folder: Path) -> bool:
    """Whether a folder has a scene.json of make-scene's."""
    if not (folder / SCENE).is_file():
        return False
    scene = read_json(folder / SCENE)
    return isinstance(scene, dict) and scene.get("schema") == SCHEMA


def rendered_cases(folder: Path) -> list[Case]:
    """The lens images of one scene; none if the scene was made without lens images.

    Raises InputError, one line, for missing or inconsistent files.
    """
    scene = read_json(folder / SCENE)
    images = scene.get("lens_images")
    if not isinstance(images, list):
        raise InputError(folder / SCENE, "no lens_images", "a list of images through a thin lens")
    cases = []
    for index, lens in enumerate(images):
        try:
            view, image = str(lens["view"]), str(lens["image"])
            numbers = {key: float(lens[key]) for key in _NUMBERS}
        except (KeyError, TypeError, ValueError) as error:
            raise InputError(
                folder / SCENE, f"lens_images[{index}] without {error}", f"view, image, {', '.join(_NUMBERS)}"
            ) from None
        files = {
            "sharp": folder / "images_linear" / f"{view}.exr",
            "depth": folder / "depth" / f"{view}.exr",
            "photograph": folder / image,
        }
        for path in files.values():
            if not path.is_file():
                raise InputError(path, "nothing", f"a file that {SCENE} names")
        width, height = image_size(files["photograph"])
        optics = PhysicalLens(numbers["aperture_scene"], 1 / numbers["focus_scene"], width)
        by_geometry = partial(thin_lens, folder, scene, view, optics) if has_geometry(scene) else None
        content = [numbers, {name: sha256_file(path) for name, path in files.items()}]
        cases.append(
            Case(
                "rendered",
                folder.name,
                numbers["aperture"],
                numbers["focus"],
                content,
                width * height / 1e6,
                partial(_photograph, files, numbers, by_geometry),
                view=view,
                geometry=has_geometry(scene),
            )
        )
    return cases


def _photograph(
    files: dict[str, Path], numbers: dict[str, float], by_geometry: Callable[[int], np.ndarray] | None
) -> Truth:
    sharp, photograph, depth = read_image(files["sharp"]), read_image(files["photograph"]), read_exr(files["depth"])
    for name, found in (("photograph", photograph.shape[:2]), ("depth", depth.shape)):
        if found != sharp.shape[:2]:
            raise InputError(files[name], f"an array of {found}", f"one of {sharp.shape[:2]}")
    if not np.isfinite(depth).all() or (depth < 0).any():
        raise InputError(files["depth"], "depth that is negative or not finite", "z > 0, and 0 where there is nothing")
    if by_geometry is not None:
        # Builds the stage and compiles its rendering beforehand, so that no renderer's time includes this
        by_geometry(2)
    # Pixels without a surface are infinitely far.
    disparity = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    signed = (numbers["aperture_scene"] * (disparity - 1 / numbers["focus_scene"])).astype(np.float32)
    return Truth(
        sharp=encode(np.maximum(sharp, 0)),
        signed_radius=signed,
        photograph=encode(np.clip(photograph, 0, 1)),
        border=math.ceil(float(np.abs(signed).max())) + 2,
        own_error_db=numbers["noise_psnr_db"],
        thin_lens=by_geometry,
    )
