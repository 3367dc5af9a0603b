"""Render a stage by Mitsuba: through a pinhole or a thin lens, and exact depth."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.lens import PhysicalLens
from dofbench.optics.tone import decode, encode
from dofbench.scenes.procedural.stage import Mesh, Prop, Sphere, Stage

# Samples per pixel of one call: jittered on a grid of 8 x 8 over the pixel and, independently, over the lens and the
# lights. Larger sets would gain little, need more memory, and delay the reaction to a signal.
_GRID = 8
_SQUARE = 1e-3  # tolerated relative difference of the focal lengths: a fifth of a pixel at an image's edge


@dataclass(frozen=True, eq=False)
class Photograph:
    """A rendered image. linear: (H, W, 3) float32, linear light, not clipped. samples: rays per pixel.

    From two independent halves of the samples, noise_rms: standard deviation of `linear`; noise_psnr: PSNR in dB,
    encoded and clipped, against infinitely many samples (inf if the halves are equal).
    """

    linear: np.ndarray
    samples: int
    noise_rms: float
    noise_psnr: float

    @property
    def noise(self) -> dict[str, float]:
        """The two numbers for scene.json, infinite PSNR as 200 dB; rounded, as on an edge that two triangles share a
        few pixels differ between runs in the last bit."""
        return {
            "noise_rms_linear": float(f"{self.noise_rms:.3g}"),
            "noise_psnr_db": round(min(self.noise_psnr, 200.0), 2),
        }


def sets_of(samples: int) -> tuple[int, int]:
    """(number of sets, samples of a set) of jittered sets with at least `samples` in total, in two equal halves."""
    side = max(1, min(_GRID, math.isqrt(samples // 2)))
    return 2 * math.ceil(samples / (2 * side * side)), side * side


class Tracer:
    """Renders one stage with direct light and shadows, without interreflection. Needs `choose_variant` first."""

    def __init__(self, stage: Stage):
        import mitsuba as mi

        self._scene = load_stage(stage)
        # In addition to a ray aimed at a light, one ray is sampled where the surface reflects most, for gloss and the
        # wide sky. It would hit shining props rarely and give bright outliers, so it is skipped in stages with such
        # props.
        shining = any(prop.finish == "lamp" for prop in stage.props)
        self._integrator = mi.load_dict({"type": "direct", "emitter_samples": 1, "bsdf_samples": int(not shining)})

    def photograph(
        self,
        camera: Camera,
        samples: int,
        key: str,
        lens: PhysicalLens | None = None,
        *,
        window: tuple[slice, slice] | None = None,
        tick: Callable[[], None] = lambda: None,
    ) -> Photograph:
        """Render the camera's image; each pixel is the mean over its square.

        samples: rays per pixel, rounded up to whole sets (`sets_of`). key: seed of the random numbers, as text. lens:
        None or of aperture 0 is a pinhole. window: (rows, columns) to render, with other random numbers than the whole
        image. tick: called after each set. Raises ValueError for a lens focused at infinity or beyond, and for a camera
        without square pixels or a centred principal point.
        """
        import mitsuba as mi

        rows, columns = window or (slice(0, camera.height), slice(0, camera.width))
        count, size = sets_of(samples)
        sensor = mi.load_dict(self._sensor(camera, size, lens, rows, columns))
        halves = np.zeros((2, rows.stop - rows.start, columns.stop - columns.start, 3))
        for index in range(count):
            digest = hashlib.sha256(f"{key}/{index}".encode()).digest()
            # mi.render isn't used, since it replaces the exception that a signal raises by another one.
            image = self._integrator.render(self._scene, sensor, seed=int.from_bytes(digest[:4], "little"), spp=size)
            halves[index % 2] += np.array(image, dtype=np.float64)
            tick()
        halves /= count / 2
        # The standard deviation of the mean of two halves is half of that of their difference.
        noise = float(np.sqrt(np.mean((halves[0] - halves[1]) ** 2))) / 2
        shown = [encode(np.clip(half, 0, 1)) for half in halves]
        squared = float(np.mean((shown[0] - shown[1]) ** 2)) / 4
        return Photograph(
            halves.mean(axis=0).astype(np.float32),
            count * size,
            noise,
            math.inf if squared == 0 else -10 * math.log10(squared),
        )

    def depth(self, camera: Camera) -> np.ndarray:
        """z-depth (H, W) float32 of the first surface behind each pixel's centre, scene units; 0 for none. (Mitsuba's
        own depth is the ray's length, averaged over the pixel.)"""
        import mitsuba as mi

        x, y = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        local = np.stack([*camera.rays(x, y), np.ones_like(x)], axis=-1)
        local = local.reshape(-1, 3)
        length = np.linalg.norm(local, axis=1)
        world = (local / length[:, None]) @ camera.world_to_camera[:3, :3]
        centre = camera.centre
        if str(mi.variant()).startswith("scalar"):
            origin = [float(v) for v in centre]
            hits = [self._scene.ray_intersect(mi.Ray3f(mi.Point3f(origin), mi.Vector3f(way.tolist()))) for way in world]
            t = np.array([float(hit.t) for hit in hits])
        else:
            ray = mi.Ray3f(mi.Point3f(*[float(v) for v in centre]), mi.Vector3f(world.T.astype(np.float32)))
            t = np.array(self._scene.ray_intersect(ray).t, dtype=np.float64)
        z = np.where(np.isfinite(t), t / length, 0.0)
        return z.reshape(camera.height, camera.width).astype(np.float32)

    def _sensor(
        self, camera: Camera, samples: int, lens: PhysicalLens | None, rows: slice, columns: slice
    ) -> dict[str, Any]:
        import mitsuba as mi

        if not math.isclose(camera.fx, camera.fy, rel_tol=_SQUARE) or (camera.cx, camera.cy) != (
            camera.width / 2,
            camera.height / 2,
        ):
            raise ValueError("camera: expected square pixels and the principal point in the middle")
        # Mitsuba's camera looks along +z with x to the left and y up: OpenCV's axes with the signs of x and y changed.
        to_world = camera.camera_to_world @ np.diag([-1.0, -1.0, 1.0, 1.0])
        sensor = {
            "type": "perspective",
            "fov_axis": "x",
            "fov": math.degrees(2 * math.atan(camera.width / (2 * camera.fx))),
            "near_clip": 1e-3,
            "far_clip": 1e6,
            "to_world": mi.ScalarTransform4f(to_world),
            "film": {
                "type": "hdrfilm",
                "width": camera.width,
                "height": camera.height,
                "crop_offset_x": columns.start,
                "crop_offset_y": rows.start,
                "crop_width": columns.stop - columns.start,
                "crop_height": rows.stop - rows.start,
                "pixel_format": "rgb",
                "component_format": "float32",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "multijitter", "sample_count": samples},
        }
        if lens is None or lens.aperture == 0:
            return sensor
        if not lens.focus_disparity > 0:
            raise ValueError(f"focus: expected a plane in front of the lens, found disparity {lens.focus_disparity}")
        # Through a lens point at distance u from the axis, a point at depth z is seen fx u (1 / focus - 1 / z) pixels
        # from where a pinhole sees it. So the blur's radius is fx times the lens's radius times that difference.
        return sensor | {
            "type": "thinlens",
            "aperture_radius": lens.half_opening(camera),
            "focus_distance": 1 / lens.focus_disparity,
        }


def load_stage(stage: Stage) -> Any:
    """The stage as a Mitsuba scene. Needs `choose_variant` first."""
    import mitsuba as mi

    parts = {f"prop_{index:04d}": _prop(prop) for index, prop in enumerate(stage.props)}
    for index, lamp in enumerate(stage.lamps):
        look = mi.ScalarTransform4f().look_at(list(lamp.centre), list(lamp.target), [0.1, 1, 0])
        parts[f"lamp_{index}"] = {
            "type": "rectangle",
            "to_world": look @ mi.ScalarTransform4f().scale(lamp.side / 2),
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": lamp.radiance}},
        }
    if isinstance(stage.sky, np.ndarray):
        # Mitsuba's maps have y at the zenith and go round from -z through x. After a quarter turn about x the zenith is
        # the world's z, and they go round from y through x. Ours go round from x through y.
        turned = np.ascontiguousarray(np.roll(stage.sky[:, ::-1], stage.sky.shape[1] // 4, axis=1), np.float32)
        parts["sky"] = {
            "type": "envmap",
            "bitmap": mi.Bitmap(turned),
            "to_world": mi.ScalarTransform4f().rotate([1, 0, 0], 90),
        }
    elif stage.sky > 0:
        parts["sky"] = {"type": "constant", "radiance": {"type": "rgb", "value": stage.sky}}
    # Parallel loading, and merging of meshes, which depends on memory addresses, would put the lamps in another order
    # in every run, so that the same random numbers would choose other lamps.
    return mi.load_dict({"type": "scene", **parts}, parallel=False, optimize=False)


def _prop(prop: Prop) -> Any:
    import mitsuba as mi

    shape = prop.shape
    if isinstance(shape, Mesh):
        return _mesh(shape, _look(prop))
    turned = mi.ScalarTransform4f().rotate([0, 0, 1], shape.turn)
    if isinstance(shape, Sphere):
        placed = mi.ScalarTransform4f().translate(list(shape.centre)) @ turned
        return {"type": "sphere", "to_world": placed.scale(shape.radius), **_look(prop)}
    start, axis = np.asarray(shape.start), np.subtract(shape.end, shape.start)
    length = float(np.linalg.norm(axis))
    side = [1.0, 0.0, 0.0] if abs(axis[2]) > 0.5 * length else [0.0, 0.0, 1.0]
    placed = mi.ScalarTransform4f().look_at(start.tolist(), list(shape.end), side) @ turned
    ends = {"p0": [0, 0, 0], "p1": [0, 0, length], "radius": shape.radius}
    return {"type": "cylinder", **ends, "to_world": placed, **_look(prop, top_down=False)}


def _look(prop: Prop, top_down: bool = True) -> dict[str, Any]:
    """The surface, and the light of a lamp; reflectance in linear light. top_down: first texture row at v = 0."""
    linear = decode(np.asarray(prop.texture, np.float64)).astype(np.float32)
    if not top_down and linear.ndim == 3:
        linear = linear[::-1]
    if prop.finish == "lamp":
        # A sampling weight of 0 means that rays are never aimed at the lamp, and in a stage with lamps `Tracer` doesn't
        # sample reflected rays either: so the lamp doesn't illuminate other props.
        light = {"type": "area", "radiance": _paint(linear * prop.radiance), "sampling_weight": 0.0}
        return {"surface": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}, "light": light}
    paint = _paint(linear)
    if prop.finish == "glossy":
        return {"surface": {"type": "roughplastic", "alpha": prop.roughness, "diffuse_reflectance": paint}}
    if prop.finish == "metal":
        metal = {"type": "roughconductor", "material": "none", "alpha": prop.roughness, "specular_reflectance": paint}
        return {"surface": {"type": "twosided", "bsdf": metal}}
    return {"surface": {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": paint}}}


def _paint(linear: np.ndarray) -> dict[str, Any]:
    import mitsuba as mi

    if linear.ndim == 3:
        bitmap = mi.Bitmap(np.ascontiguousarray(linear))
        return {"type": "bitmap", "bitmap": bitmap, "raw": True, "filter_type": "bilinear"}
    return {"type": "rgb", "value": linear.tolist()}


def _mesh(shape: Mesh, look: dict[str, Any]) -> Any:
    import mitsuba as mi

    properties = mi.Properties()
    for name, part in look.items():
        properties[name] = mi.load_dict(part)
    properties["face_normals"] = True
    mesh = mi.Mesh("mesh", len(shape.vertices), len(shape.faces), has_vertex_texcoords=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = shape.vertices.astype(np.float32).ravel()
    # v = 0 is the bitmap's first row, which is the texture's top: v = 1 in `Mesh`.
    parameters["vertex_texcoords"] = (shape.uv * (1, -1) + (0, 1)).astype(np.float32).ravel()
    parameters["faces"] = shape.faces.astype(np.uint32).ravel()
    parameters.update()
    return mesh
