"""Scenes by make-scene: all-in-focus image, exact depth, and images rendered with a thin-lens camera (`scene.json`).

The renderer "thinlens" renders such a scene again with any number of rays.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, lru_cache, partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.files import read_json, sha256_file
from dofbench.core.images import image_size, read_exr, read_image
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.renderer.renderer_truth import Case, Truth, existing
from dofbench.optics.tone import encode

if TYPE_CHECKING:
    from dofbench.scenes.procedural.tracer import Tracer

SCENE, SCHEMA = "scene.json", "dofbench-scene"
_NUMBERS = ("aperture", "focus", "aperture_scene", "focus_scene", "noise_psnr_db")


def is_rendered(folder: Path) -> bool:
    """Whether a folder has a scene.json of make-scene."""
    if not (folder / SCENE).is_file():
        return False
    scene = read_json(folder / SCENE)
    return isinstance(scene, dict) and scene.get("schema") == SCHEMA


def rendered_cases(folder: Path) -> list[Case]:
    """The lens images of one scene, possibly none. Raises InputError for missing or inconsistent files."""
    scene = read_json(folder / SCENE)
    images = scene.get("lens_images")
    if not isinstance(images, list):
        raise InputError(folder / SCENE, "no lens_images", "a list of images through a thin lens")
    geometry, cases = _has_geometry(scene), []
    for index, lens in enumerate(images):
        try:
            view, image = str(lens["view"]), str(lens["image"])
            numbers = {key: float(lens[key]) for key in _NUMBERS}
        except (KeyError, TypeError, ValueError) as error:
            expected = f"view, image, {', '.join(_NUMBERS)}"
            raise InputError(folder / SCENE, f"lens_images[{index}] without {error}", expected) from None
        files = {
            name: existing(folder / path, f"a file that {SCENE} names")
            for name, path in (
                ("sharp", f"images_linear/{view}.exr"),
                ("depth", f"depth/{view}.exr"),
                ("photograph", image),
            )
        }
        width, height = image_size(files["photograph"])
        optics = PhysicalLens(numbers["aperture_scene"], 1 / numbers["focus_scene"], width)
        by_geometry = partial(_thin_lens, folder, scene, view, optics) if geometry else None
        make = partial(_photograph, files, numbers, by_geometry)
        content = [numbers, {name: sha256_file(path) for name, path in files.items()}]
        lens_of = numbers["aperture"], numbers["focus"]
        cases.append(Case("rendered", folder.name, *lens_of, content, width * height / 1e6, make, view, geometry))
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
        by_geometry(2)  # builds and compiles beforehand, so that no renderer's time includes this
    # Pixels without a surface are infinitely far.
    disparity = np.divide(1.0, depth, out=np.zeros(depth.shape), where=depth > 0)
    signed = (numbers["aperture_scene"] * (disparity - 1 / numbers["focus_scene"])).astype(np.float32)
    return Truth.from_linear(sharp, photograph, signed, numbers["noise_psnr_db"], by_geometry)


def _has_geometry(scene: dict[str, Any]) -> bool:
    """Whether scene.json names a recipe and its renderer is installed."""
    named = isinstance(scene.get("recipe"), str) and isinstance(scene.get("seed"), int)
    return named and find_spec("mitsuba") is not None


def _thin_lens(folder: Path, scene: dict[str, Any], view: str, lens: PhysicalLens, samples: int) -> np.ndarray:
    """A view through `lens` with `samples` rays per pixel, (H, W, 3) float32, encoded."""
    _choose_variant()
    # Other random numbers than those of the scene's own images, with which this rendering is compared.
    stream = f"validate/{scene['recipe']}/{view}"
    shot = _tracer(scene["recipe"], scene["seed"]).photograph(_cameras(folder)[view], samples, stream, lens)
    return encode(np.clip(shot.linear, 0, 1))


@cache
def _choose_variant() -> None:
    from dofbench.scenes.procedural.variant import choose_variant

    choose_variant()


@lru_cache(maxsize=1)
def _tracer(recipe_name: str, seed: int) -> Tracer:
    from dofbench.scenes.procedural.recipes import recipe
    from dofbench.scenes.procedural.tracer import Tracer

    return Tracer(recipe(recipe_name).stage(seed))


@lru_cache(maxsize=1)
def _cameras(folder: Path) -> dict[str, Camera]:
    from dofbench.scenes.readers import nerfstudio

    return {view.name: view.camera for view in nerfstudio.read(folder, width=None, images=None, hold=None).views}
