"""Small folders of ground truth in the layouts that are read; their content is planes before a lens."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from truth_fakes import HEIGHT, WIDTH, looked_at

from dofbench.core.files import write_json
from dofbench.core.images import write_exr, write_png
from dofbench.evaluation.renderer import planes
from dofbench.optics.tone import encode

WALLS = (planes.Plane(1, 4.0, "all", 0.0), planes.Plane(2, 4.0, "discs", 1.0))
STEPS, FAR, NEAR = 2, -0.4, 0.4


@pytest.fixture
def small(monkeypatch):
    """Planes of few pixels, seen from few points."""
    monkeypatch.setattr(planes, "WIDTH", WIDTH)
    monkeypatch.setattr(planes, "HEIGHT", HEIGHT)
    monkeypatch.setattr(planes, "POINTS", (64, 64))
    planes._pictures.cache_clear()
    yield
    planes._pictures.cache_clear()


@pytest.fixture
def blb(tmp_path, small) -> Path:
    """BLB's layout, as its README describes it: two scenes, two blur levels, two focuses; walls at depths 1 and 4."""
    root = tmp_path / "BLB"
    for scene in ("277", "278"):
        folder = root / scene
        folder.mkdir(parents=True)
        blurs, distances = [4.0, 8.0], [1.0, 4.0]
        write_json(folder / "info.json", {"blur_parameters": blurs, "focus_distances": distances, "f_stops": [1, 2]})
        for level, blur in enumerate(blurs):
            for place, distance in enumerate(distances):
                # Disparities 1 and 1/4 are the planes' 1 and 0.
                pinhole, photograph, signed = looked_at(0.75 * blur, (1 / distance - 0.25) / 0.75)
                write_exr(folder / f"bokeh_{level:02d}_{place:02d}.exr", photograph)
        write_exr(folder / "image.exr", pinhole)
        depth = 1 / (signed / blur + 1 / distance)
        write_exr(folder / "depth.exr", np.repeat(depth[..., None], 3, axis=2))
        write_exr(folder / "depth_corrupted_00.exr", np.repeat(depth[..., None], 3, axis=2))
        for name in ("image", "disparity", "bokeh_00_00"):
            (folder / f"{name}.jpg").write_bytes(b"not looked at")
    return root


@pytest.fixture
def rendered(tmp_path, small) -> Path:
    """A folder as make-scene writes it: a wall at infinity (depth 0), discs at depth 2, two lenses."""
    folder = tmp_path / "suite" / "walls"
    images = []
    for focus, focus_scene in ((1.0, 2.0), (0.5, 4.0)):
        pinhole, photograph, signed = looked_at(5.0, focus)
        image = f"lens/a_{focus}.exr"
        write_exr(folder / image, photograph)
        lens = {"aperture": 0.5, "focus": focus, "aperture_scene": 10.0, "focus_scene": focus_scene}
        noise = {"samples": 256, "noise_rms_linear": 1e-3, "noise_psnr_db": 52.5}
        images.append({"view": "000", "image": image, **lens, **noise})
    write_exr(folder / "images_linear" / "000.exr", pinhole)
    depth = np.where(signed > 0, 2.0, 0.0)
    write_exr(folder / "depth" / "000.exr", depth)
    write_json(
        folder / "scene.json",
        {"schema": "dofbench-scene", "version": 1, "name": "walls", "seed": 0, "render": {}, "lens_images": images},
    )
    return folder


@pytest.fixture
def lightfield(tmp_path, small) -> Path:
    """Views of two walls, disparity 0.4 far and -0.4 near: nearer things move against the camera."""
    path = tmp_path / "field"
    for row in range(-STEPS, STEPS + 1):
        for column in range(-STEPS, STEPS + 1):
            # The lens' points are the views; a point of signed radius s moves by s per unit, here -0.4 to 0.4.
            image = planes.seen(WALLS, NEAR - FAR, 0.5, np.array([(-column, -row)], dtype=float))[0].sum(0)
            write_png(path / "views" / f"{row + 5:02d}_{column + 5:02d}.png", encode(np.clip(image, 0, 1)))
    np.save(path / "disparity.npy", -planes.seen(WALLS, NEAR - FAR, 0.5, np.zeros((1, 2)))[1])
    (path / "grid.json").write_text(
        json.dumps(
            {"centre": "05_05", "disparity_px_per_view_step": {"horizontal": [FAR, NEAR], "vertical": [FAR, NEAR]}}
        )
    )
    return path
