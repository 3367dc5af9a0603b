"""Stages of make-scene: depth and pinhole images of all views, points, then thin-lens images."""

from __future__ import annotations

import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.file_lock import only_writer
from dofbench.core.files import replacing
from dofbench.core.images import read_exr
from dofbench.core.lens import DisparityRange, Lens
from dofbench.core.progress import Progress
from dofbench.scenes.depth.disparity import scene_range
from dofbench.scenes.export import write_transforms
from dofbench.scenes.procedural import sparse_points
from dofbench.scenes.procedural.recipes import Recipe, recipe
from dofbench.scenes.procedural.scene_folder import SPARSE, SUMS, TRANSFORMS, SceneFolder, readme
from dofbench.scenes.procedural.scene_options import MakeScene
from dofbench.scenes.procedural.stage import cameras
from dofbench.scenes.procedural.tracer import Tracer, sets_of
from dofbench.scenes.procedural.variant import choose_variant

Tick = Callable[[], None]


def make(settings: MakeScene, progress: Progress) -> list[Path]:
    """Make the scenes, or their missing parts; returns their folders.

    Of several scenes, views and one thin-lens image of each are made first, so that every scene can be used early.
    Raises the InputErrors of `choose_variant` and `SceneFolder`.
    """
    variant, remark = choose_variant(settings.variant)
    if remark:
        print(remark, file=sys.stderr, flush=True)
    with ExitStack() as locks:
        scenes = []
        for name in settings.recipes:
            locks.enter_context(only_writer(settings.folder(name)))
            how = recipe(name)
            folder = SceneFolder(settings.folder(name), name, how.TITLE, settings, variant)
            scenes.append(_Rendering(folder, how, settings))
        total = sum(scene.sets_left() for scene in scenes)
        if total:
            with progress.stage("sets of rays", total) as advance:
                tick = _counter(advance)
                for scene in scenes:
                    scene.views(tick)
                    scene.lenses(tick, most=1 if len(scenes) > 1 else None)
                for scene in scenes:
                    scene.lenses(tick)
                    scene.seal()
        for scene in scenes:
            scene.seal()
            entries = scene.folder.record["lens_images"]
            progress.finished(scene.folder.root, f"{settings.views} views, {len(entries)} photographs through lenses")
    return [scene.folder.root for scene in scenes]


@dataclass(frozen=True)
class _Shot:
    view: int
    lens: Lens


class _Rendering:
    """Renders one scene into its folder. The stage is built when it is first needed."""

    _loaded: tuple[object, Tracer] | None = None  # only the last tracer is kept, because stages are large

    def __init__(self, folder: SceneFolder, how: Recipe, settings: MakeScene):
        self.folder, self._how, self._settings = folder, how, settings
        self._names = [f"view_{index:03d}" for index in range(settings.views)]
        self._key = f"{folder.record['recipe']}/{settings.seed}"

    def sets_left(self) -> int:
        """Sets of rays that are still to be traced."""
        pinhole, lens = sets_of(self._settings.samples)[0], sets_of(self._settings.lens_samples)[0]
        return pinhole * sum(not self.folder.has_image(name) for name in self._names) + lens * len(self._open())

    def views(self, tick: Tick) -> None:
        """Make depth, pinhole images, cameras and points, as far as they are missing."""
        record = self.folder.record
        missing = [index for index, name in enumerate(self._names) if not self.folder.has_image(name)]
        if not missing and "sparse" in record:
            return
        self.folder.unseal()
        views = self._cameras
        for name, camera in zip(self._names, views, strict=True):
            if not self.folder.depth_path(name).is_file():
                self.folder.keep_depth(name, self._tracer.depth(camera))
        if "disparity_range" not in record:
            found = scene_range(self._depths)
            record["disparity_range"] = [found.q_min, found.q_max]
            record["depth"] = _about_depth(self._depths(), self._settings.depth_bits)
            write_transforms(
                self.folder.root / TRANSFORMS,
                [f"images/{name}.png" for name in self._names],
                views,
                depth_paths=[f"depth/{name}.exr" for name in self._names],
            )
            self.folder.save()
        for index in missing:
            name = self._names[index]
            key = f"{self._key}/{name}"
            self.folder.keep_image(name, self._tracer.photograph(views[index], self._settings.samples, key, tick=tick))
        if "sparse" not in record:
            record["sparse"] = self._points(views)
            self.folder.save()

    def lenses(self, tick: Tick, most: int | None = None) -> None:
        """Make the missing photographs through lenses, at most `most` of them."""
        asked = self._settings.lens_samples
        for shot in self._open()[:most]:
            self.folder.unseal()
            camera, name = self._cameras[shot.view], self._names[shot.view]
            lens = shot.lens.physical(DisparityRange(*self.folder.record["disparity_range"]), camera.width)
            key = f"{self._key}/{name}/{shot.lens.aperture!r}/{shot.lens.focus!r}"
            photograph = self._tracer.photograph(camera, asked, key, lens, tick=tick)
            self.folder.keep_lens_image(
                name, shot.lens.aperture, shot.lens.focus, (lens.aperture, lens.focus_depth), asked, photograph
            )

    def seal(self) -> None:
        """Mark the folder as complete, unless it is marked."""
        if not (self.folder.root / SUMS).is_file():
            self.folder.seal(readme(self.folder.record, self._settings))

    def _open(self) -> list[_Shot]:
        asked = self._settings
        shots = [
            _Shot(index * asked.views // asked.lens_views, Lens(aperture, focus))
            for index in range(asked.lens_views)
            for focus in asked.focus
            for aperture in asked.aperture
        ]
        exists, samples = self.folder.has_lens_image, asked.lens_samples
        return [one for one in shots if not exists(self._names[one.view], one.lens.aperture, one.lens.focus, samples)]

    @property
    def _tracer(self) -> Tracer:
        if _Rendering._loaded is None or _Rendering._loaded[0] is not self:
            _Rendering._loaded = None
            _Rendering._loaded = (self, Tracer(self._how.stage(self._settings.seed)))
        return _Rendering._loaded[1]

    @property
    def _cameras(self) -> list[Camera]:
        asked = self._settings
        return cameras(self._how.VIEWPOINTS, asked.path, asked.views, asked.width, asked.height, asked.seed)

    def _depths(self) -> Iterator[np.ndarray]:
        return (read_exr(self.folder.depth_path(name)) for name in self._names)

    def _points(self, views: list[Camera]) -> dict[str, float | str | int]:
        """Write sparse/0; returns the record of its content."""
        output = self.folder.root / SPARSE
        with tempfile.TemporaryDirectory() as work:
            made = Path(work) / "model"
            files = [f"{name}.png" for name in self._names]
            model = sparse_points.triangulate(views, files, self.folder.root / "images", Path(work), made)
            for file in sorted(made.iterdir()):
                with replacing(output / file.name) as temporary:
                    shutil.copyfile(file, temporary)
        about: dict[str, float | str | int] = {"pycolmap": version("pycolmap"), "points": model.num_points3D()}
        if model.num_points3D():
            errors = sparse_points.depth_errors(views, model, list(self._depths()))
            about |= {
                "mean_track_length": round(model.compute_mean_track_length(), 3),
                "mean_reprojection_error_px": round(model.compute_mean_reprojection_error(), 4),
                "median_relative_depth_error": round(float(np.median(errors)), 6),
            }
        return about


def _about_depth(maps: Iterator[np.ndarray], bits: int) -> dict[str, object]:
    depth = np.stack(list(maps))
    known = depth[depth > 0]
    return {
        "meaning": "z at the pixel's centre, scene units; 0 where there is no surface",
        "fraction_bits": bits,
        "min": float(known.min()),
        "max": float(known.max()),
        "infinite_fraction": round(float((depth == 0).mean()), 6),
    }


def _counter(advance: Callable[[int], None]) -> Tick:
    done = 0

    def tick() -> None:
        nonlocal done
        done += 1
        advance(done)

    return tick
