"""The stages of make-dataset. Each stage keeps files that an earlier run has finished."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from dofbench import __version__
from dofbench.core.cameras import Camera
from dofbench.core.errors import InputError
from dofbench.core.file_lock import only_writer
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.images import read_exr, read_image, to_8bit, write_exr, write_png
from dofbench.core.progress import Progress
from dofbench.datasets.format import layout
from dofbench.datasets.format.schema import SourceRecord, ViewRecord
from dofbench.datasets.synthesis import write
from dofbench.datasets.synthesis.dataset_options import MakeDataset
from dofbench.datasets.synthesis.depth_bounds import bounds_of_views
from dofbench.datasets.synthesis.depth_record import make_depth
from dofbench.datasets.synthesis.depth_sources import source_for
from dofbench.datasets.synthesis.lens_plan import Plan, PlannedView, deal_plan, draw_plan
from dofbench.datasets.synthesis.light_field import LightField
from dofbench.datasets.synthesis.masked_views import unreached, write_view_masks
from dofbench.datasets.synthesis.method_points import choose_points
from dofbench.datasets.synthesis.photographing import Optics, exposed
from dofbench.datasets.synthesis.real_photographs import make_of_photographs
from dofbench.datasets.synthesis.render_views import Photography, shallow_image, shallow_light, view_record
from dofbench.datasets.synthesis.scene_source import (
    check_source,
    encoded,
    image_digests,
    largest_image,
    light_of,
    source_record,
)
from dofbench.datasets.synthesis.sibling import take_over, take_over_all
from dofbench.datasets.synthesis.work import WORK, Identity, finish, noise_file, prepare
from dofbench.runtime.view_threads import over_views, views_at_once
from dofbench.scenes.depth.given import with_folder_depth
from dofbench.scenes.depth.network import find_network, network_digest
from dofbench.scenes.depth.source import SourceId
from dofbench.scenes.light_field.grid import is_grid
from dofbench.scenes.loading import print_notes
from dofbench.scenes.named import Reading, ResolvedScene, find_data_root, resolve
from dofbench.scenes.on_disk import clipped_pixels, for_display
from dofbench.scenes.readers.exif_files import split_by_f_number
from dofbench.scenes.readers.folders import listed
from dofbench.scenes.reconstruction.posed_points import program
from dofbench.scenes.scene import Scene, SceneView, Split

BUILT_IN = "tabletop"


def find_scene(settings: MakeDataset) -> ResolvedScene:
    """The scene that the settings ask for; by default the built-in scene.

    Raises InputError when the scene doesn't exist, or when a named dataset with several scenes is given.
    """
    text = BUILT_IN if settings.scene is None else settings.scene
    scenes = [scene for scene in resolve(text, find_data_root(settings.data_root)) if not scene.missing]
    if len(scenes) > 1:
        raise InputError(text, f"{len(scenes)} scenes", f"one of {listed(scene.label for scene in scenes)}")
    return scenes[0]


def read_scene(found: ResolvedScene, settings: MakeDataset) -> tuple[Scene, MakeDataset]:
    """Read the scene; returns it with settings that are completed by the named dataset's defaults, and name the scene
    by its label."""
    asked = Reading(
        width=settings.width,
        images=settings.images,
        layout=settings.layout,
        hold=settings.hold,
        alpha_channel=settings.alpha_channel,
        skip_missing=settings.skip_missing,
    )
    scene = found.load(**asked).unmasked()
    print_notes(scene)
    if settings.train_f_number is not None and settings.test_f_number is not None:
        if settings.photographs == "auto" and scene.photographs != "shallow":
            raise InputError(
                "--train-f-number",
                f"{scene.name}, whose photographs count as all in focus",
                "--photographs shallow as well, if its photographs are shallow already",
            )
        scene = split_by_f_number(
            scene, settings.train_f_number, settings.test_f_number, test_points=settings.test_points
        )
    if settings.photographs != "auto":
        scene = scene.taken_as(train="shallow", test="shallow" if settings.photographs == "shallow" else "all-in-focus")
    if settings.coverage:
        if any(view.photograph != "shallow" for view in scene.views):
            raise InputError("--coverage", f"all-in-focus images in {scene.name}", "photographs of unknown lens alone")
        scene = scene.with_half_trained()
    return scene, replace(settings, scene=found.label, **found.reading(**asked))


def light_field_of(found: ResolvedScene, settings: MakeDataset) -> LightField | None:
    """The light field whose views are averaged, where the settings ask for one or the folder is one; else None.

    Raises InputError for --spacing without it.
    """
    if settings.photographs == "light-field" or (settings.photographs == "auto" and is_grid(found.root)):
        return LightField(found, settings)
    if settings.spacing is not None:
        raise InputError("--spacing", f"{found.label}, no light field", "--photographs light-field")
    return None


def default_folder(scene_name: str) -> Path:
    """The folder of a scene's dataset when the user doesn't give one."""
    return Path("data") / scene_name


def make(
    settings: MakeDataset, progress: Progress, *, sibling: Path | None = None, expected: SourceRecord | None = None
) -> Path:
    """Make the dataset, or what is missing of it; returns its folder. See `make_dataset`.

    sibling: a dataset of the same scene with another lens; if it is complete, its sharp images and depth are copied.
    expected: the scene that is required; InputError for any other scene. Photographs that are shallow already aren't
    blurred.
    """
    found = find_scene(settings)
    field = light_field_of(found, settings)
    scene, settings = read_scene(found, settings) if field is None else (field.scene, field.settings)
    if scene.photographs == "shallow":
        return make_of_photographs(found, scene, settings, progress, expected=expected)
    kind, place = settings.depth_source
    network = find_network(str(place)) if kind == "onnx" else None
    if kind == "folder" and place is not None:
        scene = with_folder_depth(scene, place, settings.depth_unit)
    plan = _assigned([(view.name, view.split) for view in scene.views], settings)
    source_id: SourceId = "sweep" if field is not None else source_for(kind, scene)
    if source_id in ("splat", "sfm"):
        scene.require_points(f"--depth {source_id}")
    optics: Optics | LightField | None = field
    if field is not None:
        field.check(plan)
    elif settings.renderer == "thinlens":
        optics = Optics.of_scene(found.root, settings.lens_samples)
    at_once = views_at_once(largest_image(scene))
    source = source_record(scene, found, with_depth=source_id in ("given", "folder"), at_once=at_once)
    if expected is not None:
        check_source(source, expected, scene.root)

    def identify(options: MakeDataset) -> Identity:
        parts = {
            "settings": options.recipe(),
            "depth": source_id,
            "plan": plan.hash,
            "dofbench": __version__,
            **({} if network is None else {"network": network_digest(network)}),
            **({} if optics is None else {optics.record_name: optics.record.model_dump()}),
            **({} if options.points == "scene" else {"points": program(), "bounds": "points"}),
            "source": source.model_dump(mode="json", include={"scene", "layout", "geometry"}),
        }
        return Identity(
            rest=sha256_text(canonical_json(parts)),
            images=image_digests(source),
            own_depth=source_id in ("given", "folder"),
        )

    identity = identify(settings)
    out = settings.out or default_folder(scene.name)
    with only_writer(out):
        if prepare(out, identity) == "complete":
            progress.finished(out, "up to date")
            return out
        if sibling is not None:
            take_over(sibling, out, source, settings)
        if settings.reuse is not None:
            take_over_all(settings.reuse, out, lambda points: identify(replace(settings, points=points)).digest)
        _all_in_focus(scene, out, settings, progress, at_once)
        swept = None if field is None else field.depth
        depth_record, disparity_range = make_depth(
            scene, source_id, network, settings, out, progress, swept, at_once=at_once
        )
        shared = Photography(
            # That of a light field is its centre view's, as windows must fit the grid before any depth is made.
            disparity_range=disparity_range if field is None else field.disparity_range,
            per_view=settings.normaliser == "view",
            blur=settings.blur,
            sensor=settings.sensor,
            bits=settings.bits,
            thinlens=optics.record if isinstance(optics, Optics) else None,
            light_field=None if field is None else field.record,
        )
        if isinstance(optics, Optics) and optics.remark:
            print(optics.remark, file=sys.stderr, flush=True)
        shoot = partial(_shoot, out=out, shared=shared, half=settings.linear == "exr-half", optics=optics)
        # Mitsuba renders on all cores, and one rendering at a time.
        records = _shallow(plan, scene, out, shared, shoot, progress, 1 if isinstance(optics, Optics) else at_once)
        _masks(scene, out, records, shared, at_once)
        scene = scene.noted(_highlights(scene, out, at_once))
        print_notes(scene)
        source = source.model_copy(update={"notes": scene.notes or None})
        points, points_record = choose_points(scene, settings.points, out, out / WORK / "points", progress)
        scene = replace(scene, points=points)
        near_far = bounds_of_views(scene, out, settings.points, {view.name for view in scene.views}, at_once)
        notes = write.geometry(out, scene, near_far)
        write.lens_file(out, shared, records)
        title = f"{scene.name}: {len(records)} views with a known lens"
        write.sheet(out, title, records, shared.disparity_range, at_once)
        write.readme(out, scene, settings, source, depth_record, points_record, records, notes, shared)
        write.manifest(
            out,
            name=scene.name,
            settings=settings,
            recipe=settings.recipe(),
            source=source,
            depth=depth_record,
            points=points_record,
            identity=identity.digest,
            offset=scene.offset,
            at_once=at_once,
        )
        finish(out)
    progress.finished(out, f"{len(records)} views")
    return out


def _assigned(views: list[tuple[str, Split]], settings: MakeDataset) -> Plan:
    if settings.assign == "continuous":
        return draw_plan(views, settings.values, seed=settings.seed)
    return deal_plan(views, settings.values, seed=settings.seed, held_out=settings.held_out_values)


def _all_in_focus(scene: Scene, out: Path, settings: MakeDataset, progress: Progress, at_once: int) -> None:
    def write_one(view: SceneView) -> None:
        path = layout.sharp_path(out, view.name)
        if view.linear is not None:
            light = layout.sharp_linear_path(out, view.name)
            if not light.is_file():
                write_exr(light, light_of(view), half=settings.linear == "exr-half")
            if not path.is_file():
                write_png(path, for_display(read_exr(light), settings.gamma))
        elif not path.is_file():
            write_png(path, encoded(view))

    with progress.stage("all-in-focus", len(scene.views)) as advance:
        for done, _ in enumerate(over_views(write_one, scene.views, at_once), 1):
            advance(done)


def _highlights(scene: Scene, out: Path, at_once: int) -> str:
    """How much of a scene of linear light the encoded images clip; empty for other scenes."""

    def count(name: str) -> tuple[int, int]:
        light = read_exr(layout.sharp_linear_path(out, name))
        return clipped_pixels(light), light.shape[0] * light.shape[1]

    counts = list(over_views(count, [view.name for view in scene.views if view.linear is not None], at_once))
    clipped, pixels = (sum(one[index] for one in counts) for index in (0, 1))
    if not clipped:
        return ""
    return (
        f"{clipped} of {pixels} pixels are brighter than 1: they are blurred as bright as they are, and clipped in the "
        "encoded images"
    )


def _shallow(
    plan: Plan,
    scene: Scene,
    out: Path,
    shared: Photography,
    shoot: Callable[[ViewRecord, Camera, np.ndarray], ViewRecord],
    progress: Progress,
    at_once: int,
) -> list[ViewRecord]:
    camera_of = {view.name: view.camera for view in scene.views}

    def shoot_one(planned: PlannedView) -> ViewRecord:
        depth_map = read_exr(layout.depth_path(out, planned.name))
        try:
            record = view_record(planned, depth_map, shared)
        except ValueError:
            raise InputError(
                f"view {planned.name}", "no pixel of known depth", "some, for a normaliser of its own"
            ) from None
        return shoot(record, camera_of[planned.name], depth_map)

    records = []
    with progress.stage("blur", len(plan.views)) as advance:
        for record in over_views(shoot_one, plan.views, at_once):
            records.append(record)
            advance(len(records))
    return records


def _masks(scene: Scene, out: Path, records: Sequence[ViewRecord], shared: Photography, at_once: int) -> None:
    lens_of = {record.name: record for record in records}

    def reached(view: SceneView, mask: np.ndarray) -> np.ndarray:
        return unreached(mask, read_exr(layout.depth_path(out, view.name)), lens_of[view.name], shared)

    write_view_masks(scene, out, reached, at_once)


def _shoot(
    record: ViewRecord,
    camera: Camera,
    depth_map: np.ndarray,
    *,
    out: Path,
    shared: Photography,
    half: bool,
    optics: Optics | LightField | None,
) -> ViewRecord:
    """Write a view's photograph unless it exists; returns its record, which for a photograph through a sampled lens
    states its noise."""
    linear_path, path = layout.linear_path(out, record.name), layout.shallow_path(out, record.name)
    # The noise can't be computed from the photograph's files, so it is kept in a file of its own.
    noise_path = noise_file(out, record.name)
    seen = optics is not None and record.aperture > 0
    noisy = isinstance(optics, Optics) and seen
    if not (linear_path.is_file() and path.is_file() and (noise_path.is_file() or not noisy)):
        if optics is None or not seen:
            light = layout.sharp_linear_path(out, record.name)
            if light.is_file():
                encoded, linear = shallow_light(read_exr(light), depth_map, record, shared)
            else:
                sharp = to_8bit(read_image(layout.sharp_path(out, record.name)))
                encoded, linear = shallow_image(sharp, depth_map, record, shared)
        elif isinstance(optics, LightField):
            encoded, linear = exposed(optics.photograph(camera, record), record.name, shared.sensor, shared.blur.gamma)
        else:
            shot = optics.photograph(camera, record)
            encoded, linear = exposed(shot.linear, record.name, shared.sensor, shared.blur.gamma)
            write_json(noise_path, shot.noise)
        write_exr(linear_path, linear, half=half)
        write_png(path, encoded, bits=shared.bits)
    return record.model_copy(update=read_json(noise_path)) if noisy else record
