"""Films of a trained scene: frames that are rendered once, as PNG or EXR, and a video or an animation of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from dofbench.core.cameras import Camera
from dofbench.core.contracts import Rendering
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.images import read_image, to_8bit, write_exr, write_png
from dofbench.core.lens import PhysicalLens
from dofbench.core.progress import Update, silent
from dofbench.optics.tone import decode
from dofbench.viewing.camera_paths import Path as CameraPath
from dofbench.viewing.lens_track import LensTrack

Renderer = Callable[[Camera, PhysicalLens | None], Rendering]  # as a method's `render`

FrameKind = Literal["png", "exr"]

FRAMES, DEPTH, RECORD = "frames", "depth", "film.json"


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame: its camera, and its lens or None for all in focus."""

    camera: Camera
    lens: PhysicalLens | None


def frames_of(path: CameraPath, track: LensTrack | None, count: int) -> list[Frame]:
    """`count` frames at evenly spaced moments, the first at 0 and the last at 1. track: None for all in focus."""
    frames = []
    for index in range(count):
        moment = index / max(count - 1, 1)
        camera = path(moment)
        frames.append(Frame(camera, None if track is None else track.lens(moment, camera)))
    return frames


def render_frames(
    render: Renderer,
    frames: Sequence[Frame],
    folder: Path,
    *,
    model: str = "",
    kind: FrameKind = "png",
    depth: bool = False,
    progress: Update = silent,
) -> list[Path]:
    """Render the frames as `folder`/frames/0001.png and on, those that are missing; returns their files.

    model: what tells the trained model from others, such as its sha256. kind: "exr" writes linear light as half floats.
    depth: write `folder`/depth/0001.exr and on too, z-depth in scene units, 0 where nothing is. Frames of another
    model, or of other cameras and lenses, are never mixed: InputError where `folder` holds some.
    """
    digest = sha256_text(canonical_json({"model": model, "frames": [_as_data(frame) for frame in frames]}))
    record = folder / RECORD
    if record.is_file():
        found = read_json(record)
        if not isinstance(found, dict) or found.get("digest") != digest:
            raise InputError(folder, "frames of another film", "an empty folder, or the same film, to resume it")
    else:
        write_json(record, {"digest": digest, "frames": len(frames)})
    files = [folder / FRAMES / f"{index:04d}.{kind}" for index in range(1, len(frames) + 1)]
    for index, (frame, file) in enumerate(zip(frames, files, strict=True)):
        progress("frames", index, len(frames))
        depth_file = folder / DEPTH / f"{file.stem}.exr"
        if file.is_file() and (depth_file.is_file() or not depth):
            continue
        rendering = render(frame.camera, frame.lens)
        image = np.clip(rendering.image, 0.0, 1.0)
        if depth:
            write_exr(depth_file, rendering.depth)
        if kind == "exr":
            write_exr(file, decode(image), half=True)
        else:
            write_png(file, image)
    progress("frames", len(frames), len(frames))
    return files


def write_video(files: Sequence[Path], video: Path, *, fps: float = 24.0, quality: int = 18) -> None:
    """Write frames of one size as H.264 in an MP4 that browsers play, to a temporary name first.

    files: PNGs with even numbers of rows and columns. quality: x264's constant rate factor, 0 (lossless) to 51.
    Raises InputError without the package av (extra `film`), or for frames of other sizes.
    """
    try:
        import av
    except ImportError:
        raise InputError("film", "no package av", 'pip install "dofbench[film]"; or frames alone, as PNG') from None
    part = video.with_name(f".{video.name}.part")
    height, width = read_image(files[0]).shape[:2]
    if height % 2 or width % 2:
        raise InputError(files[0], f"{width} x {height} pixels", "even numbers, which H.264 needs")
    with av.open(str(part), "w", format="mp4", options={"movflags": "faststart"}) as container:
        rate = Fraction(fps).limit_denominator(1001)
        stream: Any = container.add_stream("libx264", rate=rate, options={"crf": str(quality)})
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        for file in files:
            image = to_8bit(read_image(file))
            if image.shape[:2] != (height, width):
                found = f"{image.shape[1]} x {image.shape[0]} pixels"
                raise InputError(file, found, f"{width} x {height}, as the first frame")
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    part.replace(video)


def write_animation(files: Sequence[Path], animation: Path, *, fps: float = 24.0, quality: int = 75) -> None:
    """Write frames as an animated WebP that repeats, to a temporary name first."""
    from PIL import Image

    part = animation.with_name(f".{animation.name}.part")
    first, *rest = (Image.open(file) for file in files)
    first.save(
        part, format="WEBP", save_all=True, append_images=rest, duration=round(1000 / fps), loop=0, quality=quality
    )
    part.replace(animation)


def _as_data(frame: Frame) -> list[float]:
    camera, lens = frame.camera, frame.lens
    numbers = [camera.width, camera.height, *camera.parameters, *camera.world_to_camera.ravel().tolist()]
    return numbers if lens is None else [*numbers, lens.aperture, lens.focus_disparity, lens.width]
