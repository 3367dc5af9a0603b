"""Converts the plain data of a stage to a mitsuba scene."""

from __future__ import annotations

from typing import Any

import numpy as np

from dofbench.optics.tone import decode
from dofbench.scenes.procedural.stage import Mesh, Prop, Sphere, Stage


def load_stage(stage: Stage) -> Any:
    """The stage as a mitsuba scene. A variant must have been chosen."""
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
    return {
        "type": "cylinder",
        "p0": [0, 0, 0],
        "p1": [0, 0, length],
        "radius": shape.radius,
        "to_world": placed,
        **_look(prop, top_down=False),
    }


def _look(prop: Prop, top_down: bool = True) -> dict[str, Any]:
    """The surface, and the light of a lamp. Reflectance is the texture in linear light. top_down: the texture's first
    row is the shape's v = 0.
    """
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
