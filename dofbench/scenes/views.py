"""From what a reader found in the files to a `Scene`: checks, sizes, names, order, split. Images stay on disk."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import Coding
from dofbench.core.images import image_coding, image_size
from dofbench.scenes.local_frame import AnotherFrame, localised
from dofbench.scenes.on_disk import DepthOnDisk, ImageOnDisk, MaskOnDisk, check_size, coding_notes
from dofbench.scenes.readers.exif_files import exif_by_file
from dofbench.scenes.readers.folders import NOTHING_ENLARGED, marked_hold, scene_name, view_names
from dofbench.scenes.readers.split_files import split_by_files, split_sources, unread_note
from dofbench.scenes.scene import Scene, SceneView, Split
from dofbench.scenes.undistort import Intrinsics, undistorted
from dofbench.scenes.visibility import in_front

# Sizes rounded down a pyramid leave the aspect ratio off by a pixel: 1 % is more than that, and less than a crop.
_ASPECT = 0.01
DEFAULT_HOLD = 8
# Poses in another frame than the points leave next to no point inside the images.
_INSIDE = 0.5


@dataclass(frozen=True, eq=False)
class Frame:
    """An image as a reader found it.

    name: its path inside the scene, for the view's name. intrinsics: at the size in the camera file, which need not be
    the image's. world_to_camera: (4, 4), OpenCV axes. unit: scene units per number in the depth file. split, mask_file:
    where the layout states them.
    """

    name: str
    file: Path
    intrinsics: Intrinsics
    world_to_camera: np.ndarray
    depth_file: Path | None = None
    unit: float = 1.0
    split: Split | None = None
    mask_file: Path | None = None


def assemble(
    root: Path,
    layout: str,
    frames: Sequence[Frame],
    points: PointCloud | None,
    *,
    width: int | None,
    subject: object,
    offset: Offset | None = None,
) -> Scene:
    """Check every frame and make the scene: views sorted by name, points.views in that order, EXIF by `exif_by_file`.

    width: of every view, pixels; None keeps the images' own. Tracks lose views that the point lies behind. A scene far
    from its origin is moved near it (`localised`); offset: by how much, where known. Raises InputError about `subject`
    (the file with the poses) or about an image that is missing, unreadable, of another shape or too narrow.
    """
    if not frames:
        raise InputError(subject, "no views", "at least one")
    names = view_names([frame.name for frame in frames])
    found = [_view(frame, name, width, subject) for frame, name in zip(frames, names, strict=True)]
    codings = {view.name: coding for view, coding in found}
    exif = exif_by_file(root, {view.name: view.source for view, _ in found})
    order = sorted(range(len(found)), key=names.__getitem__)
    views = tuple(replace(found[index][0], exif=exif.get(names[index])) for index in order)
    if points is not None and points.views is not None:
        rank = np.empty(len(views), dtype=np.int64)
        rank[order] = np.arange(len(views))
        ranked = replace(points, views=tuple(np.sort(rank[track]) for track in points.views))
        points = in_front(ranked, [view.camera for view in views])
    scene = Scene(scene_name(root), root, layout, views, points)
    return localised(scene, offset, subject).noted(*coding_notes(codings), _off_centre_note(frames))


def _off_centre_note(frames: Sequence[Frame]) -> str:
    off = [frame for frame in frames if frame.intrinsics.off_centre]
    if not off:
        return ""
    lens = off[0].intrinsics
    first = f"{off[0].name}: {lens.cx:g}, {lens.cy:g} of {lens.width}x{lens.height} pixels"
    return f"principal points of {len(off)} of {len(frames)} views far from the middle of the image ({first})"


def among_all(scene: Scene, called: Mapping[Path, str], absent: Collection[str]) -> Scene:
    """The scene with its views' places among all (`Scene.places`), some of which were skipped.

    called: the name of each view's file (`SceneView.source`) in the file with the poses. absent: the names skipped.
    """
    if not absent:
        return scene
    ours = [called[view.source] for view in scene.views]
    order = {name: place for place, name in enumerate(sorted(view_names([*ours, *absent])))}
    places = [order[name] for name in view_names([*ours, *absent])[: len(ours)]]
    # Files in folders may be sorted otherwise than their names where the poses are: views keep their order.
    return replace(scene, places=tuple(sorted(places)))


def held_out(
    scene: Scene, hold: int | None, known_as: Mapping[Path, str] | None = None, absent: Collection[str] = ()
) -> Scene:
    """Split the scene by `hold`, else by files that name its views, else by the marker file `hold=N`, else by 8.

    known_as, absent: as `split_by_files`. Raises InputError.
    """
    if hold is not None:
        return held_as_asked(scene, hold, split_sources(scene.root))
    by_files = split_by_files(scene, known_as or {}, absent)
    if by_files is not None:
        return by_files
    marked = marked_hold(scene.root)
    scene = scene.noted(unread_note(scene.root))
    return replace(
        scene.with_hold(DEFAULT_HOLD if marked is None else marked), split_by=split_rule(None, marked, DEFAULT_HOLD)
    )


def split_rule(asked: int | None, marked: int | None, default: int) -> str:
    """`Scene.split_by` for a hold: the one asked for, else the marker file's, else the default."""
    if asked is not None:
        return f"hold {asked} (as asked)"
    return f"hold {default} (default)" if marked is None else f"hold {marked} (marker file)"


def held_as_asked(scene: Scene, hold: int, not_read: Sequence[str]) -> Scene:
    """Split the scene by `hold`; a note names the files with another split, which aren't read. Raises InputError."""
    note = f"split by hold {hold}, as asked, and not by {' and '.join(not_read)}" if not_read else ""
    return replace(scene.with_hold(hold), split_by=split_rule(hold, None, 0)).noted(note)


def check_inside(scene: Scene, subject: object) -> None:
    """Raise AnotherFrame unless at least half of the sightings fall inside their image; without tracks, unless half of
    the points fall inside any image."""
    points = scene.points
    if points is None:
        return
    inside = np.stack([_inside(view, points.xyz) for view in scene.views])
    if points.views is None:
        share = inside.any(axis=0).mean()
    else:
        seen = np.concatenate(points.views)
        which = np.repeat(np.arange(len(points)), [len(track) for track in points.views])
        share = inside[seen, which].mean() if len(seen) else 0.0
    if share < _INSIDE:
        expected = f"at least {_INSIDE:.0%}: points and poses in one frame"
        raise AnotherFrame(subject, f"{share:.0%} of the points inside the images that should see them", expected)


def _inside(view: SceneView, xyz: np.ndarray) -> np.ndarray:
    pixels, _ = view.camera.project(xyz)
    # NaN, behind the camera, compares false.
    return np.all((pixels >= 0) & (pixels <= (view.camera.width, view.camera.height)), axis=1)


def _view(frame: Frame, name: str, width: int | None, subject: object) -> tuple[SceneView, Coding]:
    _require(frame.file, "image", subject)
    file_width, file_height = image_size(frame.file)
    given = frame.intrinsics
    given.check_proportions(subject, frame.name)
    _check_aspect(frame.file, (file_width, file_height), given, subject)
    if width is not None and width > file_width:
        raise InputError(frame.file, f"an image {file_width} pixels wide", NOTHING_ENLARGED.format(width))
    lens = given.resized(file_width, file_height)
    try:
        straight = undistorted(lens)
    except InputError as error:
        raise InputError(subject, error.found, error.expected) from None
    size = width or file_width, max(1, int(file_height * (width or file_width) / file_width + 0.5))
    depth = mask = None
    if frame.depth_file is not None:
        _require(frame.depth_file, "depth map", subject)
        _check_aspect(frame.depth_file, image_size(frame.depth_file), given, subject)
        depth = DepthOnDisk(frame.depth_file, frame.unit, lens, *size)
    if frame.mask_file is not None:
        _require(frame.mask_file, "mask", subject)
        check_size(frame.mask_file, (file_width, file_height))
        mask = MaskOnDisk(frame.file, frame.mask_file, False, lens, *size)
    coding = image_coding(frame.file)
    image = ImageOnDisk(frame.file, lens, *size, mask, coding.linear)
    view = SceneView(
        name=name,
        camera=straight.camera(frame.world_to_camera).resized(*size),
        image=image,
        source=frame.file,
        split=frame.split or "train",
        depth=depth,
        mask=mask,
        linear=image.light if coding.linear else None,
    )
    return view, coding


def _require(file: Path, kind: str, subject: object) -> None:
    if not file.is_file():
        raise InputError(file, "no such file", f"the {kind} that {subject} names")


def _check_aspect(file: Path, size: tuple[int, int], given: Intrinsics, subject: object) -> None:
    if abs(size[0] / size[1] / (given.width / given.height) - 1) > _ASPECT:
        expected = f"the shape of its camera, {given.width}x{given.height} in {subject}"
        raise InputError(file, f"{size[0]}x{size[1]} pixels", expected)
