"""From what a reader found in the files to a `Scene`: checks, sizes, names, order. Images stay on disk."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from dofbench.core.cameras import Offset
from dofbench.core.contracts import PointCloud
from dofbench.core.errors import InputError
from dofbench.core.image_files.coding import Coding
from dofbench.core.images import image_coding, image_size, resize
from dofbench.core.masks import filled
from dofbench.scenes.depth_files import read_depth
from dofbench.scenes.light import coding_notes, for_display, read_values
from dofbench.scenes.local_frame import AnotherFrame, localised
from dofbench.scenes.readers.exif_files import exif_by_file
from dofbench.scenes.readers.folders import marked_hold, scene_name, view_names
from dofbench.scenes.readers.split_files import split_by_files, split_sources, unread_note
from dofbench.scenes.scene import Scene, SceneView, Split
from dofbench.scenes.scene_masks import MaskOnDisk, check_size
from dofbench.scenes.undistort import Intrinsics, sample_depth, undistort_image, undistorted

# Sizes rounded down a pyramid leave the aspect ratio off by a pixel: 1 % is more than that, and less than a crop.
_ASPECT = 0.01
DEFAULT_HOLD = 8
# Poses in another frame than the points leave next to no point inside the images.
_INSIDE = 0.5


@dataclass(frozen=True, eq=False)
class Frame:
    """One photograph as a reader found it.

    name: its path inside the scene, for the view's name. intrinsics: at the size of the camera
    file, which need not be the image's. world_to_camera: (4, 4), OpenCV axes. unit: scene units a
    number in the depth file. split: where the layout says it. mask_file: where the layout names one.
    """

    name: str
    file: Path
    intrinsics: Intrinsics
    world_to_camera: np.ndarray
    depth_file: Path | None = None
    unit: float = 1.0
    split: Split | None = None
    mask_file: Path | None = None


@dataclass(frozen=True)
class ImageOnDisk:
    """Reads an image, takes the distortion out, resizes: (height, width, 3) float32, encoded.

    mask: pixels that it masks are replaced by the nearest valid ones first, so they reach no others.

    linear: the file holds linear light, which `light` gives; encoded it is clipped at 1.
    A class, not a closure, so that a view can be sent to another process.
    """

    file: Path
    intrinsics: Intrinsics
    width: int
    height: int
    mask: MaskOnDisk | None = None
    linear: bool = False

    def __call__(self) -> np.ndarray:
        return for_display(self.light()) if self.linear else self._values()

    def light(self) -> np.ndarray:
        """Linear light, (height, width, 3) float32, not clipped. Raises ValueError for an encoded image."""
        if not self.linear:
            raise ValueError(f"{self.file}: expected linear light, found an encoded image")
        return self._values()

    def _values(self) -> np.ndarray:
        image = read_values(self.file, linear=self.linear)
        expected = (self.intrinsics.height, self.intrinsics.width)
        if image.shape[:2] != expected:
            size = f"{image.shape[1]}x{image.shape[0]} pixels"
            raise InputError(self.file, size, f"{expected[1]}x{expected[0]}, as when the scene was loaded")
        if self.mask is not None:
            image = filled(image, self.mask.as_stored())
        return resize(undistort_image(image, self.intrinsics, light=self.linear), self.width, self.height)


@dataclass(frozen=True)
class DepthOnDisk:
    """Reads a z-depth map and samples it (nearest) at the view's pixel centres: (height, width) float32, 0 unknown."""

    file: Path
    unit: float
    intrinsics: Intrinsics
    width: int
    height: int

    def __call__(self) -> np.ndarray:
        target = undistorted(self.intrinsics).resized(self.width, self.height)
        return sample_depth(read_depth(self.file, self.unit), self.intrinsics, target)


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
    """Check every frame and make the scene: views sorted by name, points.views turned to that order.

    width: of every view, pixels; None keeps the images' own. Raises InputError about `subject`
    (the file with the poses) or about the image that is missing, unreadable, of another shape, too narrow.
    A track loses the views that the point lies behind: no camera can have made such a sighting. What cameras wrote
    down of the photographs comes from where `exif_by_file` looks. Cameras and points far from their origin are moved
    near it (`localised`); offset: by how much, where that is known already.
    """
    if not frames:
        raise InputError(subject, "no views", "at least one")
    names = view_names([frame.name for frame in frames])
    found = [_view(frame, name, width, subject) for frame, name in zip(frames, names, strict=True)]
    views, codings = [view for view, _ in found], {view.name: coding for view, coding in found}
    exif = exif_by_file(root, {view.name: view.source for view in views})
    views = [replace(view, exif=exif.get(view.name)) for view in views]
    order = sorted(range(len(views)), key=names.__getitem__)
    if points is not None and points.views is not None:
        rank = np.empty(len(views), dtype=np.int64)
        rank[order] = np.arange(len(views))
        in_front = np.stack([views[index].camera.project(points.xyz)[1] > 0 for index in order])
        tracks = (np.sort(rank[track]) for track in points.views)
        points = replace(points, views=tuple(track[in_front[track, point]] for point, track in enumerate(tracks)))
    scene = Scene(scene_name(root), root, layout, tuple(views[index] for index in order), points)
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

    called: what each view's file (`SceneView.source`) is called where its pose is. absent: the names of those skipped.
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
    """The scene split by `hold`, else by files that name its views, else by the marker file `hold=N` in its folder,
    else by 8. known_as, absent: as `split_by_files` takes them. Raises InputError."""
    if hold is not None:
        return held_as_asked(scene, hold, split_sources(scene.root))
    by_files = split_by_files(scene, known_as or {}, absent)
    if by_files is not None:
        return by_files
    marked = marked_hold(scene.root)
    by = f"hold {DEFAULT_HOLD} (default)" if marked is None else by_marker(marked)
    scene = scene.noted(unread_note(scene.root))
    return replace(scene.with_hold(DEFAULT_HOLD if marked is None else marked), split_by=by)


def by_marker(hold: int) -> str:
    """What `Scene.split_by` says of a marker file hold=N."""
    return f"hold {hold} (marker file)"


def held_as_asked(scene: Scene, hold: int, not_read: Sequence[str]) -> Scene:
    """The scene split by `hold`; a note names the files that say another split and aren't read. Raises InputError."""
    note = f"split by hold {hold}, as asked, and not by {' and '.join(not_read)}" if not_read else ""
    return replace(scene.with_hold(hold), split_by=f"hold {hold} (as asked)").noted(note)


def check_inside(scene: Scene, subject: object) -> None:
    """Raise AnotherFrame unless at least half of the points lie where the poses see them.

    With tracks: half of the sightings fall inside their image. Without: half of the points fall
    inside at least one. Points from another frame than the poses' fail this.
    """
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
    if not frame.file.is_file():
        raise InputError(frame.file, "no such file", f"the image that {subject} names")
    file_width, file_height = image_size(frame.file)
    given = frame.intrinsics
    given.check_proportions(subject, frame.name)
    _check_aspect(frame.file, (file_width, file_height), given, subject)
    if width is not None and width > file_width:
        raise InputError(
            frame.file, f"an image {file_width} pixels wide", f"at least the {width} asked for: nothing is enlarged"
        )
    lens = given.resized(file_width, file_height)
    try:
        straight = undistorted(lens)
    except InputError as error:
        raise InputError(subject, error.found, error.expected) from None
    out_width = width or file_width
    out_height = max(1, int(file_height * out_width / file_width + 0.5))
    depth = None
    if frame.depth_file is not None:
        if not frame.depth_file.is_file():
            raise InputError(frame.depth_file, "no such file", f"the depth map that {subject} names")
        _check_aspect(frame.depth_file, image_size(frame.depth_file), given, subject)
        depth = DepthOnDisk(frame.depth_file, frame.unit, lens, out_width, out_height)
    mask = None
    if frame.mask_file is not None:
        if not frame.mask_file.is_file():
            raise InputError(frame.mask_file, "no such file", f"the mask that {subject} names")
        check_size(frame.mask_file, (file_width, file_height))
        mask = MaskOnDisk(frame.file, frame.mask_file, False, lens, out_width, out_height)
    coding = image_coding(frame.file)
    image = ImageOnDisk(frame.file, lens, out_width, out_height, mask, coding.linear)
    view = SceneView(
        name=name,
        camera=straight.camera(frame.world_to_camera).resized(out_width, out_height),
        image=image,
        source=frame.file,
        split=frame.split or "train",
        depth=depth,
        mask=mask,
        linear=image.light if coding.linear else None,
    )
    return view, coding


def _check_aspect(file: Path, size: tuple[int, int], given: Intrinsics, subject: object) -> None:
    ratio = (size[0] / size[1]) / (given.width / given.height)
    if abs(ratio - 1) > _ASPECT:
        expected = f"the shape of its camera, {given.width}x{given.height} in {subject}"
        raise InputError(file, f"{size[0]}x{size[1]} pixels", expected)
