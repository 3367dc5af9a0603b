"""The scene of a dataset: its record by content, and its images as the dataset stores them."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

import numpy as np

from dofbench.core.cameras import NO_OFFSET
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, sha256_file, sha256_text
from dofbench.core.images import image_size, to_8bit
from dofbench.datasets.format.schema import SourceImage, SourceRecord
from dofbench.runtime.view_threads import over_views
from dofbench.scenes.named import ResolvedScene
from dofbench.scenes.scene import Scene, SceneView


def largest_image(scene: Scene) -> int:
    """Pixels of the largest image that is read or written for a view."""
    return max(max(view.camera.width * view.camera.height, math.prod(image_size(view.source))) for view in scene.views)


def source_record(scene: Scene, found: ResolvedScene, with_depth: bool, at_once: int) -> SourceRecord:
    """The record of a scene's content. with_depth: whether its depth maps are part of it. at_once: views to read at a
    time."""
    digest = hashlib.sha256()

    def content(view: SceneView) -> tuple[np.ndarray | None, SourceImage]:
        image = SourceImage(
            view=view.name,
            sha256=sha256_file(view.source),
            photograph=view.photograph if scene.photographs == "shallow" else None,
            mask=_mask_digest(view),
            linear=None if view.linear is None else True,
        )
        depth = view.depth() if with_depth and view.depth is not None else None
        return None if depth is None else np.ascontiguousarray(depth, dtype=np.float32), image

    images = []
    for view, (depth, image) in zip(scene.views, over_views(content, scene.views, at_once), strict=True):
        camera = view.camera
        digest.update(
            canonical_json(
                {
                    "name": view.name,
                    "split": view.split,
                    "size": [camera.width, camera.height],
                    "intrinsics": list(camera.parameters),
                    "world_to_camera": camera.world_to_camera.tolist(),
                }
            ).encode()
        )
        if depth is not None:
            digest.update(depth.data)
        images.append(image)
    if scene.offset != NO_OFFSET:
        digest.update(canonical_json({"offset": scene.offset}).encode())
    if scene.points is not None:
        for array in (scene.points.xyz, scene.points.rgb, scene.points.error, *(scene.points.views or ())):
            digest.update(np.ascontiguousarray(array).tobytes() + b"|")
    return SourceRecord(
        scene=scene.name,
        layout=scene.layout,
        geometry=digest.hexdigest(),
        images=tuple(images),
        licence=found.licence,
        terms=found.terms,
        citation=found.citation,
        origin=found.origin,
        role=found.role,
        role_by=found.role_by or None,
        own_side=max(image_size(scene.views[0].source)) if scene.photographs == "shallow" else None,
        notes=scene.notes or None,
    )


def image_digests(source: SourceRecord) -> dict[str, str]:
    """What identifies each view's image, and its mask where it has one."""
    return {
        image.view: image.sha256 if image.mask is None else sha256_text(f"{image.sha256} {image.mask}")
        for image in source.images
    }


def _mask_digest(view: SceneView) -> str | None:
    mask = None if view.mask is None else view.mask()
    return None if mask is None or mask.all() else hashlib.sha256(np.packbits(mask).tobytes()).hexdigest()


def light_of(view: SceneView) -> np.ndarray:
    """The view's linear light, (H, W, 3) float32. Raises InputError unless it is of its camera's size, and ValueError
    for a view that is encoded."""
    if view.linear is None:
        raise ValueError(f"view {view.name}: expected linear light, found an encoded image")
    light = view.linear()
    _check_size(view, light)
    return light


def encoded(view: SceneView) -> np.ndarray:
    """The view's image in 8 bits. Raises InputError unless it is encoded, in [0, 1], and of its camera's size."""
    image = view.image()
    _check_size(view, image)
    if not np.isfinite(image).all() or image.min() < 0 or image.max() > 1:
        raise InputError(view.source, f"values from {image.min():g} to {image.max():g}", "an encoded image in [0, 1]")
    return to_8bit(image)


def _check_size(view: SceneView, image: np.ndarray) -> None:
    size = (view.camera.height, view.camera.width, 3)
    if image.shape != size:
        raise InputError(view.source, f"an image of shape {image.shape}", f"{size}, as its camera")


def check_source(source: SourceRecord, expected: SourceRecord, root: Path) -> None:
    """Raise InputError unless the scene is the one that a manifest is of."""
    before, now = image_digests(expected), image_digests(source)
    if before.keys() != now.keys():
        raise InputError(root, f"{len(now)} views", f"the {len(before)} of the manifest, by name")
    for view, digest in now.items():
        if before[view] != digest:
            raise InputError(root, f"another image or mask of view {view}", "those whose sha256 is in the manifest")
    if source.geometry != expected.geometry:
        raise InputError(root, "other cameras, split, depth or points", "those of the manifest")
