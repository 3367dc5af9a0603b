"""Render the training images of depthnet: many small rooms with exact depth, and make-scene's scenes with other seeds.

    python datasets/depthnet/render.py --out WORK/rooms --minutes 15

Needs the extra `render` (mitsuba). Writes one .npz per room: images (V, H, W, 3) uint8, encoded; depth (V, H, W)
float16, scene units, 0 = no surface. A second call renders the rooms that are missing. Rooms from number 1000000 on are
held out, and no training room has such a number.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rooms
import tyro

from dofbench.core.files import replacing
from dofbench.core.images import to_8bit
from dofbench.optics.tone import encode
from dofbench.scenes.procedural import stage as stages
from dofbench.scenes.procedural.recipes import recipe
from dofbench.scenes.procedural.scene_options import NAMES
from dofbench.scenes.procedural.tracer import Tracer
from dofbench.scenes.procedural.variant import choose_variant

WIDTH, HEIGHT = 256, 192
RECIPES = 3  # every third room is a make-scene recipe, with a seed that no shipped scene has
SAMPLES = 32  # rays per pixel: few, since noise is an augmentation, and sensor noise is added anyway
BANK_ROOMS = 24  # rooms that share one bank of textures


@dataclass(frozen=True)
class Settings:
    """What to render and where."""

    out: Path
    """Folder for the rooms."""
    rooms: int = 1000
    """Largest number of rooms."""
    first: int = 0
    """Number of the first room, which is also its seed; 1000000 for held-out rooms."""
    views: int = 12
    """Views per room."""
    minutes: float = 15.0
    """Stop after so many minutes."""


def main(settings: Settings) -> None:
    """Render until the number of rooms or the time is reached."""
    choose_variant()
    start = time.perf_counter()
    bank, banked = [], -1
    for number in range(settings.first, settings.first + settings.rooms):
        if time.perf_counter() - start > 60 * settings.minutes:
            break
        file = settings.out / f"{number:07d}.npz"
        if file.is_file():
            continue
        if number % RECIPES == RECIPES - 1:
            turn = number // RECIPES
            how, seed = recipe(NAMES[turn % len(NAMES)]), 1 + number
            stage = how.stage(seed)
            kind: stages.PathKind = "forward" if turn // len(NAMES) % 2 == 0 else "orbit"
            cameras = stages.cameras(how.VIEWPOINTS, kind, settings.views, WIDTH, HEIGHT, seed)
        else:
            if number // BANK_ROOMS != banked:
                banked = number // BANK_ROOMS
                bank = rooms.texture_bank(np.random.default_rng([banked, 7]), 2)
            rng = np.random.default_rng([number, 11])
            stage = rooms.room(rng, bank)
            cameras = rooms.cameras(rng, settings.views, WIDTH, HEIGHT)
        tracer = Tracer(stage)
        images, depths = [], []
        for index, camera in enumerate(cameras):
            linear = tracer.photograph(camera, SAMPLES, f"{number}/{index}").linear
            images.append(to_8bit(encode(np.clip(linear, 0, 1))))
            depths.append(tracer.depth(camera).astype(np.float16))
        with replacing(file) as temporary:
            np.savez_compressed(temporary, images=np.stack(images), depth=np.stack(depths))
        done = number - settings.first + 1
        if done % 10 == 0:
            print(f"{done} rooms, {time.perf_counter() - start:.0f} s", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Settings))
