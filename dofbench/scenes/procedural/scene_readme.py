"""The README of a rendered scene, and the command that makes it again."""

from __future__ import annotations

import shlex
from dataclasses import fields
from typing import Any

from dofbench.core.markdown_text import block, literal
from dofbench.core.options import flag, spelled
from dofbench.scenes.procedural.scene_options import MakeScene


def command(recipe: str, settings: MakeScene) -> str:
    """The command line that makes this scene."""
    words = ["dofbench", "make-scene", recipe]
    for field in fields(MakeScene):
        value = getattr(settings, field.name)
        if field.name not in ("recipe", "out", "variant") and value != field.default:
            words += [flag(field.name), spelled(value) if isinstance(value, tuple) else str(value)]
    return shlex.join(words)


def readme(record: dict[str, Any], settings: MakeScene) -> str:
    """Text about the scene. record: its scene.json."""
    depth, render = record["depth"], record["render"]
    title = record["title"][0].upper() + record["title"][1:]
    size = f"{settings.width} x {settings.height}"
    return f"""# {literal(record["name"])}, a rendered scene

{title}. Everything is procedural, from seed {record["seed"]}; licence {record["licence"]}.

{block(command(record["recipe"], settings))}

| what | where |
| --- | --- |
| {settings.views} pinhole images of {size}, encoded by 1 / 2.2, clipped, 8 bit | `images/` |
| the same, linear, not clipped; {render["samples"]} samples a pixel{_noise(record["images"])} | `images_linear/` |
| z at the pixels' centres, {depth["min"]:.4g} to {depth["max"]:.4g} scene units, 0 at infinity | `depth/` |
| photographs through a thin lens, linear: {_lenses(record["lens_images"])} | `lens/` |
| cameras, nerfstudio's layout | `transforms.json` |
| cameras and {record["sparse"]["points"]} triangulated points, COLMAP's layout | `sparse/0` |
| lenses, noise of every image, settings, versions | `scene.json` |

Light is direct, with shadows and gloss; what bounces from thing to thing is left out, so a surface looks the same to
every point of a lens but for its gloss. A lens of `aperture_scene` (px * scene unit) and `focus_scene` blurs depth z by
a disc of radius `aperture_scene * |1 / z - 1 / focus_scene|` pixels. Noise is what two independent halves of
the samples say: its standard deviation in linear light, and in dB of the encoded, clipped image.
"""


def _lenses(entries: list[dict[str, Any]]) -> str:
    if not entries:
        return "none"
    return f"{len(entries)}, {entries[0]['samples']} samples a pixel{_noise(entries)}"


def _noise(entries: list[dict[str, Any]]) -> str:
    return f", noise {min(entry['noise_psnr_db'] for entry in entries):.1f} dB or better"
