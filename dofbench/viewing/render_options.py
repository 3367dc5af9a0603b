"""The options of `dofbench render`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import NumberSequence, flag, given, options, spelled

PathName = Literal["training", "spiral", "orbit", "dolly", "dolly-zoom", "still"]
FilmFormat = Literal["mp4", "webp", "png", "exr"]
Ease = Literal["smooth", "linear", "in", "out"]


@options()
class Render:
    """Render a film of a trained scene: a camera path, with a focus pull and a change of aperture."""

    result: Annotated[Path, tyro.conf.Positional]
    """A run's folder, as `dofbench run` wrote it."""
    out: Path = Path("film")
    """Folder for the frames and film.mp4; rerun the same command to resume."""
    path: PathName = "spiral"
    """training: through the training cameras. spiral: about those that look as --view does. orbit: around what the
    cameras look at. dolly: forward by half the way to the focus. dolly-zoom: the same, with what is in focus first held
    at its size. still: the view of --view."""
    keyframes: Path | None = None
    """Keyframes of camera, focus and aperture, as the viewer saves them, in place of --path, --focus and --aperture."""
    view: str | None = None
    """Training or test view of spiral, dolly, dolly-zoom, still and --follow. Default: the first test view."""
    frames: Annotated[int, Field(ge=1)] = 96
    """Number of frames."""
    fps: Annotated[float, Field(gt=0)] = 24.0
    """Frames a second of the video."""
    width: Annotated[int, Field(ge=16)] | None = None
    """Width in pixels. Default: that of the dataset."""
    focus: NumberSequence[float] = (0.2, 0.8, 0.2)
    """Focus at evenly spaced moments, comma-separated: normalised disparity of the scene, 0 far to 1 near."""
    follow: NumberSequence[Annotated[float, Field(ge=0, le=1)]] | None = None
    """X,Y: the point of the scene seen there at --view stays in focus, in place of --focus. Shares of width and height
    from the top left."""
    aperture: NumberSequence[Annotated[float, Field(ge=0)]] | None = None
    """Aperture at evenly spaced moments, comma-separated: 1 blurs by 2 % of the width per unit of disparity, 0 not at
    all. Default: the median learned one, or 1 without a lens."""
    ease: Ease = "smooth"
    """How focus and aperture move between their values."""
    blades: Annotated[int, Field(ge=0)] = 0
    """Blades of the aperture; 0 for a disc. With blades, and for methods without a lens, the all-in-focus rendering is
    blurred by its depth, in layers."""
    rotation: float = 0.0
    """Direction of the polygon's first corner, degrees from right towards down."""
    format: FilmFormat = "mp4"
    """mp4: PNG frames and film.mp4 (H.264). webp: PNG frames and film.webp, which repeats. png: frames alone. exr:
    frames of linear light."""
    depth: bool = False
    """Write every frame's depth too, as EXR, scene units."""

    def __post_init__(self) -> None:
        if self.blades in (1, 2):
            raise InputError("--blades", str(self.blades), "0 for a disc, or at least 3")
        if self.follow is not None and len(self.follow) != 2:
            raise InputError("--follow", spelled(self.follow), "two numbers X,Y, shares of width and height")
        if self.keyframes is not None:
            for name in ("path", "focus", "follow", "aperture", "ease"):
                if given(self, name):
                    raise InputError(flag(name), "--keyframes too", "one of them: keyframes hold camera and lens")
        if self.follow is not None and given(self, "focus"):
            raise InputError("--focus", "--follow too", "one of them")
