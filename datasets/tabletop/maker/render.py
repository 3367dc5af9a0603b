"""Rendering a stage with mitsuba: colour light by light, z-depth by one ray through each pixel's centre."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.cameras import Camera
from dofbench.errors import InputError
from dofbench.images import decode

from .props import Mesh, Prop, Sphere, Stage, Tube

VECTORISED, SCALAR = "llvm_ad_rgb", "scalar_rgb"
# Older versions load, then abort the whole process at the first render.
_LLVM_OLDEST = 17
_LIBRARY_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64", "/usr/lib",
                    "/usr/local/lib", "/opt/homebrew/opt/llvm/lib")
_PROBE = (
    "import mitsuba as mi; mi.set_variant('llvm_ad_rgb');"
    "print(mi.render(mi.load_dict(mi.cornell_box() | {'integrator': {'type': 'direct'}}), spp=1).numpy().mean())"
)


@dataclass(frozen=True, eq=False)
class Pass:
    """A mitsuba scene lit by one light. aimed: rays are sent to the light. samples: rays a pixel."""

    scene: Any
    aimed: bool
    samples: int


def choose_variant(wanted: str = "auto") -> str:
    """Pick mitsuba's variant and select it: the vectorised one if it survives a trial in another process.

    wanted: "auto" or a variant's name. Sets DRJIT_LIBLLVM_PATH when a library was found by search.
    """
    try:
        import mitsuba as mi
    except ImportError as error:
        raise InputError("mitsuba", f"not importable ({error})", "the extra: pip install 'dofbench[render]'") from error

    variant = wanted
    if wanted == "auto":
        library = _find_llvm()
        variant = SCALAR if library is None else VECTORISED
        if library:
            os.environ["DRJIT_LIBLLVM_PATH"] = library
    if variant not in mi.variants():
        raise InputError("variant", wanted, f"auto or one of {', '.join(mi.variants())}")
    mi.set_variant(variant)
    return variant


def load(stage: Stage) -> list[Pass]:
    """One pass a light, the ambient light first. A variant must have been chosen.

    Lights are rendered one at a time and added: each gets the sampling that suits it, and choosing
    between lights at random adds no noise. Light that bounces between props is left out; the
    ambient light stands in for it.
    """
    import mitsuba as mi

    # The shapes are loaded once and shared by the passes.
    shapes = {f"prop_{index:03d}": _load(_prop(prop)) for index, prop in enumerate(stage.props)}
    ambient = {"type": "constant", "radiance": {"type": "rgb", "value": stage.ambient.radiance}}
    passes = [Pass(mi.load_dict({"type": "scene", **shapes, "light": ambient}), False, stage.ambient.samples)]
    for lamp in stage.lamps:
        look = mi.ScalarTransform4f().look_at(list(lamp.centre), list(lamp.target), [0, 1, 0])
        light = {
            "type": "rectangle",
            "to_world": look @ mi.ScalarTransform4f().scale(lamp.side / 2),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lamp.radiance}},
        }
        passes.append(Pass(mi.load_dict({"type": "scene", **shapes, "light": light}), True, lamp.samples))
    return passes


def colour(passes: list[Pass], camera: Camera, seed: int, samples: int | None = None) -> np.ndarray:
    """Linear light (H, W, 3) float32; each pixel is the mean over its square.

    samples: rays a pixel for every light, a square number; None takes each light's own.
    """
    import mitsuba as mi

    # Mitsuba's camera looks along +z with x to the left and y up: OpenCV's with x and y turned round.
    to_world = camera.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
    total = np.zeros((camera.height, camera.width, 3), np.float32)
    for index, part in enumerate(passes):
        count = part.samples if samples is None else samples
        sensor = mi.load_dict({
            "type": "perspective",
            "fov_axis": "x",
            "fov": float(np.degrees(2 * np.arctan(camera.width / (2 * camera.fx)))),
            "near_clip": 0.01,
            "far_clip": 100.0,
            "to_world": mi.ScalarTransform4f(to_world),
            "film": {
                "type": "hdrfilm", "width": camera.width, "height": camera.height,
                "pixel_format": "rgb", "component_format": "float32", "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": count},
        })
        # A lamp is a small part of what a surface sees, so rays go to it; the ambient light is all of it.
        integrator = mi.load_dict({
            "type": "direct", "emitter_samples": int(part.aimed), "bsdf_samples": int(not part.aimed),
        })
        image = mi.render(part.scene, sensor=sensor, integrator=integrator, spp=count, seed=64 * seed + index)
        total += np.array(image, dtype=np.float32)
    return total


def depth(passes: list[Pass], camera: Camera) -> np.ndarray:
    """z-depth (H, W) float32 of the first surface behind each pixel's centre, scene units; 0 where there is none.

    The renderer's own depth output is the ray's length averaged over the pixel, which is neither.
    """
    import mitsuba as mi

    scene = passes[0].scene
    x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    local = np.stack([(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy, np.ones_like(x)], axis=-1)
    local = local.reshape(-1, 3)
    length = np.linalg.norm(local, axis=1)
    world = (local / length[:, None]) @ camera.world_to_camera[:3, :3]
    centre = camera.centre
    if mi.variant().startswith("scalar"):
        origin = [float(v) for v in centre]
        hits = [scene.ray_intersect(mi.Ray3f(origin, [float(v) for v in way])) for way in world]
        t = np.array([float(hit.t) for hit in hits])
    else:
        ray = mi.Ray3f(mi.Point3f(*[float(v) for v in centre]), mi.Vector3f(world.T.astype(np.float32)))
        t = np.array(scene.ray_intersect(ray).t, dtype=np.float64)
    z = np.where(np.isfinite(t), t / length, 0.0)
    return z.reshape(camera.height, camera.width).astype(np.float32)


def _find_llvm() -> str | None:
    """Path of an LLVM library with which a trial render works, newest first; None when there is none."""
    given = os.environ.get("DRJIT_LIBLLVM_PATH")
    candidates = [given] if given else _installed_llvm()
    for library in candidates:
        trial = subprocess.run(
            [sys.executable, "-c", _PROBE], env=os.environ | {"DRJIT_LIBLLVM_PATH": library},
            capture_output=True, check=False,
        )
        if trial.returncode == 0:
            return library
    return None


def _installed_llvm() -> list[str]:
    found: dict[int, str] = {}
    for folder in _LIBRARY_FOLDERS:
        for path in Path(folder).glob("libLLVM*"):
            version = re.search(r"(\d+)", path.name.replace("libLLVM", ""))
            if version and int(version[1]) >= _LLVM_OLDEST:
                found.setdefault(int(version[1]), str(path))
    return [found[version] for version in sorted(found, reverse=True)]


def _load(part: Any) -> Any:
    import mitsuba as mi

    return mi.load_dict(part) if isinstance(part, dict) else part


def _prop(prop: Prop) -> Any:
    import mitsuba as mi

    shape = prop.shape
    if isinstance(shape, Mesh):
        return _mesh(shape, _surface(prop))
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], shape.turn)
    if isinstance(shape, Sphere):
        placed = mi.ScalarTransform4f().translate(list(shape.centre)) @ turned
        return {"type": "sphere", "to_world": placed.scale(shape.radius), "bsdf": _surface(prop)}
    assert isinstance(shape, Tube)
    start, axis = np.asarray(shape.start), np.subtract(shape.end, shape.start)
    length = float(np.linalg.norm(axis))
    side = [1.0, 0.0, 0.0] if abs(axis[2]) > 0.5 * length else [0.0, 0.0, 1.0]
    placed = mi.ScalarTransform4f().look_at(start.tolist(), list(shape.end), side) @ turned
    return {
        "type": "cylinder", "p0": [0, 0, 0], "p1": [0, 0, length], "radius": shape.radius,
        "to_world": placed, "bsdf": _surface(prop, top_down=False),
    }


def _surface(prop: Prop, top_down: bool = True) -> dict[str, Any]:
    """Reflectance is the texture in linear light. top_down: the texture's first row is the shape's v = 0."""
    import mitsuba as mi

    linear = decode(np.asarray(prop.texture, np.float64)).astype(np.float32)
    if linear.ndim == 3:
        bitmap = mi.Bitmap(np.ascontiguousarray(linear if top_down else linear[::-1]))
        paint = {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear"}
    else:
        paint = {"type": "rgb", "value": linear.tolist()}
    if prop.finish == "glossy":
        return {"type": "roughplastic", "alpha": 0.10, "diffuse_reflectance": paint}
    return {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": paint}}


def _mesh(shape: Mesh, surface: dict[str, Any]) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    properties["surface"] = mi.load_dict(surface)
    properties["face_normals"] = True
    mesh = mi.Mesh("mesh", len(shape.vertices), len(shape.faces), has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = shape.vertices.astype(np.float32).ravel()
    # v = 0 is the bitmap's first row, which is the texture's top: v = 1 in `Mesh`.
    parameters["vertex_texcoords"] = (shape.uv * (1, -1) + (0, 1)).astype(np.float32).ravel()
    parameters["faces"] = shape.faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh
