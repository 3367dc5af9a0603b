"""A radiance field through a lens that is given: sampled by rays, or scattered by its depth."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from dofbench.core.blur import Blur
from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.errors import InputError
from dofbench.core.lens import PhysicalLens
from dofbench.optics.defocus import defocus_numpy
from dofbench.training.fields.field_scene import FieldScene
from dofbench.training.fields.forward.lens_rays import disc_points
from dofbench.training.fields.forward.mixed_rays import mixed
from dofbench.training.fields.pixels import CameraTable, whole_image

_RAYS = 8192  # rendered at once


@dataclass(frozen=True)
class LensRenderingOptions:
    """How finely a lens is sampled in a photograph that is rendered."""

    render_points: int = 16
    """Rays from points of the lens that a pixel of a rendered photograph is mixed from. Unit: none. Source: own."""

    def __post_init__(self) -> None:
        if self.render_points < 1:
            raise InputError("option render_points", str(self.render_points), "at least 1")


@torch.no_grad()
def through_points(scene: FieldScene, camera: Camera, lens: PhysicalLens, count: int) -> Rendering:
    """The photograph as the mean light of `count` rays a pixel from points of the lens, the same in every call. The
    depth is the sharp view's."""
    device = scene.device
    table, places = CameraTable([camera], device), whole_image(camera, device)
    generator = torch.Generator().manual_seed(0)
    aperture = lens.aperture_at(camera.width)
    parts = []
    for part in places.split(max(1, _RAYS // count)):
        points = disc_points(len(part), count, generator, device).view(-1, 2)
        shift = points * (aperture / table.focal[0])
        views = torch.zeros(len(part) * count, dtype=torch.int64, device=device)
        rays = table.rays(views, part.repeat_interleave(count, 0), shift, -lens.focus_disparity * shift)
        seen = scene.see(*rays, torch.full((len(views),), 0.5, device=device))
        parts.append(mixed(seen.color.view(-1, count, 3), torch.full((1, count), 1 / count, device=device)))
    image = torch.cat(parts).view(camera.height, camera.width, 3).clamp(0, 1).numpy(force=True)
    return Rendering(image, scene.render(camera).depth)


def scattered(sharp: Rendering, lens: PhysicalLens, blur: Blur = Blur()) -> Rendering:
    """The photograph as the sharp view whose pixels are spread over their circles of confusion."""
    image, _ = defocus_numpy(sharp.image, sharp.depth, lens, blur)
    return Rendering(image.clip(0, 1), sharp.depth)
