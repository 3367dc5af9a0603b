"""Make the built-in scene `tabletop`: render it, triangulate its sparse points, check it, write it.

    python datasets/tabletop/make.py --out DIR

Needs the extra `render` (mitsuba). The seed fixes everything; see README.md for how far a second
run agrees with the first.
"""

from __future__ import annotations

import sys
import tempfile
import time
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np
import tyro
from maker import path, props, render, sparse

from dofbench.errors import InputError
from dofbench.files import sha256_file, write_json, write_text
from dofbench.images import encode, read_exr, read_image, write_exr, write_png
from dofbench.lens import GAMMA
from dofbench.scenes.export import write_transforms

# Depth is kept in steps of 2 ** -11 units: files a third smaller, and no circle of confusion moves by more than
# two thousandths of a pixel.
DEPTH_STEP = 2.0**-11


@dataclass(frozen=True)
class Settings:
    """What to make and where."""

    out: Path
    """Folder to write the scene to; images/, depth/, sparse/, transforms.json, scene.json, SHA256SUMS."""
    seed: int = 0
    """Fixes textures, props, camera path and the renderer's random numbers."""
    views: int = 20
    """Number of views."""
    width: int = 320
    """Image width, pixels."""
    height: int = 240
    """Image height, pixels."""
    samples: int | None = None
    """Rays a pixel for every light, a square number; by default each light has its own (maker/props.py)."""
    variant: str = "auto"
    """Mitsuba variant; auto takes llvm_ad_rgb where it runs, else scalar_rgb."""


def main(settings: Settings) -> None:
    """Make the scene and print where it is."""
    if settings.samples is not None and round(settings.samples**0.5) ** 2 != settings.samples:
        raise InputError("--samples", str(settings.samples), "a square number")
    out = settings.out
    variant = render.choose_variant(settings.variant)
    stage = props.stage(settings.seed)
    passes = render.load(stage)
    cameras = path.cameras(settings.views, settings.width, settings.height, settings.seed)
    names = [f"view_{index:03d}" for index in range(len(cameras))]
    clipped = []
    start = time.perf_counter()
    for index, (camera, name) in enumerate(zip(cameras, names, strict=True)):
        picture = encode(render.colour(passes, camera, index, settings.samples))
        clipped.append(float((picture > 1).any(axis=2).mean()))
        write_png(out / "images" / f"{name}.png", picture)
        z = render.depth(passes, camera)
        write_exr(out / "depth" / f"{name}.exr", np.round(z / DEPTH_STEP) * DEPTH_STEP)
        spent = time.perf_counter() - start
        left = spent / (index + 1) * (len(cameras) - index - 1)
        print(f"{name}: {index + 1} of {len(cameras)}, {spent:.0f} s, about {left:.0f} s left", flush=True)

    # The noise is what a second render with other random numbers changes, before rounding to 8 bits.
    pair = [
        np.clip(encode(render.colour(passes, cameras[0], seed, settings.samples)), 0, 1)
        for seed in (len(cameras), len(cameras) + 1)
    ]
    noise = (pair[0] - pair[1]) * 255 / np.sqrt(2)

    with tempfile.TemporaryDirectory() as work:
        files = [f"{name}.png" for name in names]
        model = sparse.triangulate(cameras, files, out / "images", Path(work), out / "sparse" / "0")
    depths = [read_exr(out / "depth" / f"{name}.exr") for name in names]
    errors = sparse.depth_errors(cameras, model, depths)

    write_transforms(
        out / "transforms.json", [f"images/{file}" for file in files], cameras,
        depth_paths=[f"depth/{name}.exr" for name in names],
    )
    write_json(out / "scene.json", {
        "name": "tabletop",
        "origin": "synthetic; textures, props and path are procedural, made by datasets/tabletop/make.py",
        "licence": "CC0-1.0",
        "seed": settings.seed,
        "images": {
            "views": len(cameras), "width": settings.width, "height": settings.height, "gamma": GAMMA,
            "linear_above_1": "clipped", "clipped_fraction": round(float(np.mean(clipped)), 5),
            "mean_encoded": round(float(np.mean([read_image(out / "images" / name).mean() for name in files])), 4),
        },
        "render": {
            "mitsuba": version("mitsuba"), "variant": variant, "sampler": "multijitter", "filter": "box",
            "samples_per_pixel": [settings.samples or part.samples for part in passes],
            "noise_rms_8bit_levels": round(float(noise.std()), 3),
            "noise_p95_8bit_levels": round(float(np.percentile(np.abs(noise), 95)), 3),
        },
        "depth": {
            "meaning": "z at the pixel's centre, scene units", "step": DEPTH_STEP,
            "min": float(min(z.min() for z in depths)), "max": float(max(z.max() for z in depths)),
        },
        "sparse": {
            "pycolmap": version("pycolmap"), "points": model.num_points3D(),
            "mean_track_length": round(model.compute_mean_track_length(), 3),
            "mean_reprojection_error_px": round(model.compute_mean_reprojection_error(), 4),
            "median_relative_depth_error": round(float(np.median(errors)), 6),
        },
    })
    listed = [out / "scene.json", out / "transforms.json"]
    for part in ("depth", "images", "sparse"):
        listed += sorted(file for file in (out / part).rglob("*") if file.is_file())
    lines = [f"{sha256_file(file)}  {file.relative_to(out).as_posix()}\n" for file in listed]
    write_text(out / "SHA256SUMS", "".join(lines))
    print(f"{out}: {len(cameras)} views, {model.num_points3D()} points, noise {noise.std():.2f} of 255 levels")


if __name__ == "__main__":
    try:
        main(tyro.cli(Settings))
    except InputError as mistake:
        print(f"error: {mistake}", file=sys.stderr)
        sys.exit(2)
