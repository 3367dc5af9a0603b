"""make-dataset on scenes of odd sizes, with unusual depth, invalid images and unusual options."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dofbench.core.errors import InputError
from dofbench.core.images import read_exr, write_exr, write_png
from dofbench.evaluation.stability.case import NUMPY, Case, Found, Subject
from dofbench.evaluation.stability.deviation import in_folder, not_finite, refuses
from dofbench.evaluation.stability.samples import by_size, picture

Change = Callable[[np.ndarray], np.ndarray]
SIZE = (24, 32)  # where no other is under test


def _write_scene(
    folder: Path,
    size: tuple[int, int],
    *,
    photograph: Change | None = None,
    depth: Change | None = None,
) -> Path:
    """Write a scene of three views by one camera in nerfstudio's layout."""
    height, width = size
    frames = []
    for index in range(3):
        image, z = picture(*size, seed=index), (2.0 + 3.0 * picture(*size)[..., 0]).astype(np.float32)
        image, z = photograph(image) if photograph else image, depth(z) if depth else z
        name = f"images/v{index}" + (".exr" if photograph else ".png")
        write_exr(folder / name, image) if photograph else write_png(folder / name, image)
        write_exr(folder / f"depth/v{index}.exr", z)
        pose = np.eye(4).tolist()
        frames.append({"file_path": name, "depth_file_path": f"depth/v{index}.exr", "transform_matrix": pose})
    camera = {"w": width, "h": height, "fl_x": 32.0, "fl_y": 32.0, "cx": width / 2, "cy": height / 2}
    (folder / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    return folder


def _make(scene: Path, out: Path, **options: Any) -> Path:
    from dofbench.core.progress import Silent
    from dofbench.datasets.synthesis import make_dataset
    from dofbench.datasets.synthesis.dataset_options import MakeDataset

    return make_dataset(MakeDataset(scene=str(scene), out=out, hold=2, **options), progress=Silent())


@in_folder
def _dataset(folder: Path, size: tuple[int, int] = SIZE, depth: Change | None = None, **options: Any) -> Found:
    """Make the dataset, and count its non-finite values and the problems that `dofbench check` finds."""
    from dofbench.datasets.synthesis import check_dataset

    made = _make(_write_scene(folder / "scene", size, depth=depth), folder / "made", **options)
    problems = check_dataset(made)
    records = json.loads((made / "lens.json").read_text())["views"]
    wrong = sum(not_finite(read_exr(file)) for file in sorted((made / "images_linear").glob("*.exr")))
    keys = ("max_coc_px", "aperture_scene", "k_px")
    wrong += sum(not math.isfinite(record[key]) for record in records for key in keys)
    return Found(wrong + len(problems), 0.0, "; ".join(map(str, problems))[:160].replace(str(folder), ""))


def _with_pixel(picture: np.ndarray, at: tuple[int, int], value: float) -> np.ndarray:
    picture = picture.copy()
    picture[at] = value
    return picture


def _refused(folder: Path, *words: str, photograph: Change | None = None, depth: Change | None = None) -> Found:
    scene = _write_scene(folder / "scene", SIZE, photograph=photograph, depth=depth)
    found = refuses(InputError, lambda: _make(scene, folder / "made"), "v0.exr", *words)
    return Found(found.error, found.bound, found.note.replace(str(folder), ""))


@in_folder
def _bad_light(folder: Path, value: float) -> Found:
    return _refused(folder, "light", photograph=partial(_with_pixel, at=(1, 1), value=value))


@in_folder
def _bad_depth(folder: Path, value: float) -> Found:
    return _refused(folder, depth=partial(_with_pixel, at=(1, 1), value=value))


@in_folder
def _refused_option(folder: Path, option: str, value: str) -> Found:
    scene = _write_scene(folder / "scene", SIZE)
    return refuses(InputError, lambda: _make(scene, folder / "made", **{option: (float(value),)}), f"--{option}", value)


def _all_but_one_unknown(z: np.ndarray) -> np.ndarray:
    known = np.zeros_like(z)
    known[5, 6] = z[5, 6]
    return known


def _cases() -> tuple[Case, ...]:
    made = Subject("datasets", "make-dataset", NUMPY)
    nearer = partial(_with_pixel, at=(2, 3), value=3e-6)
    return (
        *made.each("{size_label}", _dataset, size=by_size((1, 1), (1, 9), (9, 1), (17, 33))),
        made.case("flat", _dataset, depth=lambda z: np.full_like(z, 3.7)),
        made.case("outlier", _dataset, depth=nearer),
        made.case("depth-infinite", _dataset, depth=partial(_with_pixel, at=(2, 3), value=np.inf)),
        made.case("depth-mostly-unknown", _dataset, depth=_all_but_one_unknown),
        *made.each("focus-{value}", _refused_option, option=("focus",), value=("-1", "nan")),
        made.case("aperture-40", _refused_option, option="aperture", value="40"),
        made.case("focus-ends", _dataset, focus=(0, 1), aperture=(0, 1)),
        made.case("layered", _dataset, depth=nearer, renderer="layered"),
        made.case("noisy-black", _dataset, photons=10.0, read_noise=20.0),
        *made.each("photograph-{value_label}", _bad_light, value={"nan": np.nan, "inf": np.inf, "negative": -0.5}),
        *made.each("depth-{value_label}", _bad_depth, value={"nan": np.nan, "negative": -2.0}),
    )


CASES = _cases()
