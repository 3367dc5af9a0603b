"""Input of a reconstruction: a folder of photographs, a video, or a scene with known poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dofbench.core.cameras import NO_OFFSET, Offset
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, sha256_file, sha256_text
from dofbench.scenes.loading import detect, load_scene, print_notes
from dofbench.scenes.readers.folders import image_folders
from dofbench.scenes.reconstruction import video
from dofbench.scenes.reconstruction.photograph_list import LEAST, Photograph, digests, find_photographs, upright_size
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.scene import Scene
from dofbench.scenes.views import DEFAULT_HOLD

Kind = Literal["photographs", "video", "poses"]
_EXPECTED = "a folder of photographs, a video, or a scene with poses"


@dataclass(frozen=True, eq=False)
class Source:
    """Photographs to reconstruct from. views: their number, of a video at most. size: the first one's (width, height),
    upright. digests: gives the sha256 of every file, by name. photographs: called with a folder for frames and a
    progress callback. count: of the items that progress counts, 0 without. holds_split: whether the split differs from
    every eighth view. poses: digest of known cameras, split and offset, else empty. notes: on conversions and skipped
    files."""

    kind: Kind
    name: str
    views: int
    size: tuple[int, int]
    digests: Callable[[], dict[str, str]]
    photographs: Callable[[Path, Callable[[int], None]], list[Photograph]]
    count: int = 0
    holds_split: bool = False
    poses: str = ""
    offset: Offset = NO_OFFSET
    notes: tuple[str, ...] = ()


def find_source(settings: Reconstruct) -> Source:
    """Find the input of the settings. Raises InputError for one that is missing, unreadable or too small."""
    path = settings.source
    above = next(place for place in (settings.out, *settings.out.absolute().parents) if place.exists())
    if not above.is_dir():
        raise InputError("--out", str(settings.out), f"a folder; {above} is a file")
    if not path.exists():
        raise InputError(path, "no such file or folder", _EXPECTED)
    if path.is_dir():
        if path.resolve() in (settings.out.resolve(), *settings.out.resolve().parents):
            raise InputError("--out", str(settings.out), f"a folder outside of {path}, which holds the photographs")
        if settings.poses == "keep" and detect(path) is not None:
            return _posed(settings)
        found = find_photographs(path, settings.images, settings.alpha_channel)
        photographs = found.photographs
        return Source(
            "photographs",
            path.resolve().name,
            len(photographs),
            upright_size(photographs[0].source),
            lambda: digests(photographs),
            lambda folder, advance: photographs,
            notes=found.notes,
        )
    if not video.is_video(path):
        raise InputError(path, "a file that is no video", f"{_EXPECTED} ({', '.join(video.VIDEO_SUFFIXES)})")
    video.check_colours(path)
    count, size = video.announced(path), video.frame_size(path)
    return Source(
        "video",
        path.stem,
        min(count or settings.frames, settings.frames),
        size,
        lambda: {path.name: sha256_file(path)},
        lambda folder, advance: video.sharpest_frames(path, folder, settings.frames, advance),
        count=count,
    )


def _posed(settings: Reconstruct) -> Source:
    """A scene with poses, its images as stored: the poses belong to those."""
    path, images = settings.source, settings.images
    folders = image_folders(path)
    if images is None and detect(path) in ("llff", "colmap") and folders:
        images = folders[min(folders)].name
    try:
        scene = load_scene(path, images=images, alpha_channel=settings.alpha_channel)
    except InputError as error:
        anew = f"{error.expected}; or --poses ignore, to find poses anew"
        raise InputError(error.subject, error.found, anew) from None
    print_notes(scene)
    if len(scene.views) < LEAST:
        raise InputError(path, f"{len(scene.views)} views", f"at least {LEAST}")
    photographs = [
        Photograph(view.name, view.source, view.image, view.exif, view.camera, view.split, view.linear, view.mask)
        for view in scene.views
    ]
    first = scene.views[0].camera
    usual = [view.split for view in scene.with_hold(DEFAULT_HOLD).views]
    return Source(
        "poses",
        scene.name,
        len(photographs),
        (first.width, first.height),
        lambda: digests(photographs),
        lambda folder, advance: photographs,
        holds_split=[view.split for view in scene.views] != usual,
        poses=_digest(scene),
        offset=scene.offset,
        notes=scene.notes,
    )


def _digest(scene: Scene) -> str:
    """sha256 of cameras, split and offset: with the photographs they decide the points."""
    views = [
        [view.name, view.split, *view.camera.parameters, *view.camera.world_to_camera.ravel().tolist()]
        for view in scene.views
    ]
    return sha256_text(canonical_json({"views": views, "offset": scene.offset}))
