"""The folder of a rendered scene: scene.json, images, README, checksums, and resuming an unfinished scene."""

from __future__ import annotations

import shlex
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from dofbench import __version__
from dofbench.core.errors import InputError
from dofbench.core.files import read_json, refuse_links_outside, sha256_file, write_json, write_text
from dofbench.core.images import write_exr, write_png
from dofbench.core.lens import GAMMA
from dofbench.core.markdown_text import block, literal
from dofbench.core.names import inside
from dofbench.core.options import flag, spelled
from dofbench.optics.tone import encode
from dofbench.scenes.procedural.scene_options import MakeScene
from dofbench.scenes.procedural.tracer import Photograph

SCHEMA, VERSION = "dofbench-scene", 1
RECORD, SUMS, README, TRANSFORMS, SPARSE = "scene.json", "SHA256SUMS", "README.md", "transforms.json", "sparse/0"
LICENCE = "CC0-1.0"


def read_record(folder: Path) -> dict[str, Any]:
    """scene.json of a folder that make-scene wrote. Raises InputError for anything else."""
    path = folder / RECORD
    record = read_json(path)
    if not isinstance(record, dict) or record.get("schema") != SCHEMA:
        raise InputError(path, "another kind of JSON", f'a record with "schema": "{SCHEMA}", as make-scene writes it')
    if record.get("version") != VERSION:
        raise InputError(path, f"schema version {record.get('version')}", f"version {VERSION}")
    for entry in (*record.get("images", ()), *record.get("lens_images", ())):
        inside(entry["view"], path)
    for entry in record.get("lens_images", ()):
        inside(entry["image"], path)
    return record


class SceneFolder:
    """The folder of one scene. record: scene.json, written after every image, so that a kill costs one image."""

    def __init__(self, root: Path, recipe: str, title: str, settings: MakeScene, variant: str):
        """Open a folder that is new or was begun with the same settings. Raises InputError for other content."""
        self.root = root
        self._half = settings.linear == "exr-half"
        self._bits = settings.depth_bits
        named = ("seed", "path", "views", "width", "height", "samples", "linear", "depth_bits")
        asked = {name: getattr(settings, name) for name in named}
        made = {"dofbench": __version__, "recipe": recipe, **asked, "variant": variant}
        if root.is_dir():
            refuse_links_outside(root)
        if (root / RECORD).is_file():
            self.record = read_record(root)
            if self.record.get("made") != made:
                expected = "the same one (recipe, settings, variant), or another --out"
                raise InputError(root, "a scene made otherwise", expected)
            return
        if root.is_dir() and any(not path.name.startswith(".") for path in root.iterdir()):
            raise InputError(root, "files that are no rendered scene", "an empty or a new folder")
        self.record = {
            "schema": SCHEMA,
            "version": VERSION,
            "name": recipe,
            "title": title,
            "recipe": recipe,
            "seed": settings.seed,
            "path": settings.path,
            "licence": LICENCE,
            "origin": "synthetic; textures, geometry and path are procedural, made by dofbench make-scene",
            "citation": f"dofbench {__version__}, scene {recipe}, seed {settings.seed}",
            "made": made,
            "render": {
                "mitsuba": version("mitsuba"),
                "variant": variant,
                "light": "direct",
                "sampler": "multijitter",
                "filter": "box",
                "samples": settings.samples,
                "gamma": GAMMA,
            },
            "images": [],
            "lens_images": [],
        }

    def save(self) -> None:
        """Write scene.json."""
        write_json(self.root / RECORD, self.record)

    def depth_path(self, view: str) -> Path:
        """Path of the depth map: z at the pixels' centres, scene units, 0 where there is no surface."""
        return self.root / "depth" / f"{view}.exr"

    def has_image(self, view: str) -> bool:
        """Whether the view's pinhole image exists."""
        files = (self.root / "images" / f"{view}.png", self.root / "images_linear" / f"{view}.exr")
        return any(entry["view"] == view for entry in self.record["images"]) and all(path.is_file() for path in files)

    def has_lens_image(self, view: str, aperture: float, focus: float, samples: int) -> bool:
        """Whether the photograph through that lens, with so many samples, exists."""
        wanted = {"view": view, "aperture": aperture, "focus": focus, "samples": samples}
        entries = [entry for entry in self.record["lens_images"] if wanted.items() <= entry.items()]
        return any((self.root / entry["image"]).is_file() for entry in entries)

    def keep_depth(self, view: str, depth: np.ndarray) -> None:
        """Write a depth map, with its floats' fractions rounded to as many bits as the settings say."""
        dropped = 23 - self._bits
        if dropped:
            bits = np.ascontiguousarray(depth, np.float32).view(np.uint32)
            # Rounded to nearest: half of the last kept bit is added before the lower bits are cut off.
            depth = ((bits + (1 << (dropped - 1))) >> dropped << dropped).view(np.float32)
        write_exr(self.depth_path(view), depth)

    def keep_image(self, view: str, shot: Photograph) -> None:
        """Write a pinhole image, linear and encoded, and its noise into the record."""
        write_exr(self.root / "images_linear" / f"{view}.exr", shot.linear, half=self._half)
        encoded = encode(np.clip(shot.linear, 0, 1))
        write_png(self.root / "images" / f"{view}.png", encoded)
        entry = {
            "view": view,
            **shot.noise,
            "brightest": float(f"{shot.linear.max():.4g}"),
            "clipped_fraction": round(float((shot.linear > 1).any(axis=2).mean()), 6),
        }
        self._put("images", entry, "view")
        self.record["render"] |= {
            "samples": shot.samples,
            "noise_rms_linear": max(e["noise_rms_linear"] for e in self.record["images"]),
        }
        self.save()

    def keep_lens_image(
        self, view: str, aperture: float, focus: float, scene_units: tuple[float, float], asked: int, shot: Photograph
    ) -> None:
        """Write a photograph through a lens. scene_units: (aperture in px * unit, focus in unit); asked: samples."""
        name = f"lens/{view}_a{aperture:g}_f{focus:g}.exr"
        write_exr(self.root / name, shot.linear, half=self._half)
        entry = {"view": view, "image": name, "aperture": aperture, "focus": focus}
        entry |= {"aperture_scene": scene_units[0], "focus_scene": scene_units[1], "samples": asked, **shot.noise}
        self._put("lens_images", entry, "image")
        self.save()

    def seal(self, readme: str) -> None:
        """Write README.md and SHA256SUMS: the scene is complete."""
        write_text(self.root / README, readme)
        files = [self.root / name for name in (RECORD, TRANSFORMS)]
        for part in ("depth", "images", "images_linear", "lens", "sparse"):
            files += sorted(path for path in (self.root / part).rglob("*") if path.is_file() and path.name[0] != ".")
        lines = [f"{sha256_file(path)}  {path.relative_to(self.root).as_posix()}\n" for path in files]
        write_text(self.root / SUMS, "".join(lines))

    def unseal(self) -> None:
        """Remove SHA256SUMS before files are added: the scene isn't complete any more."""
        (self.root / SUMS).unlink(missing_ok=True)

    def _put(self, part: str, entry: dict[str, Any], key: str) -> None:
        others = [other for other in self.record[part] if other[key] != entry[key]]
        self.record[part] = sorted([*others, entry], key=lambda other: other[key])


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
