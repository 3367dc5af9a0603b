"""Which part and which channels of an EXR file are the picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dofbench.core.errors import InputError, first_line

_EXPECTED = "one picture: channels R, G, B or one channel"
# What Blender calls the layer with the whole picture.
_WHOLE = "combined"


@dataclass(frozen=True, eq=False)
class Part:
    """The picture of an EXR. index: of the part. spec: its header. channels: indices of R, G and B, or of one grey."""

    index: int
    spec: Any
    channels: tuple[int, ...]


def picture_part(path: Path) -> Part:
    """The part and channels that are the picture: R, G, B of the only layer that has them, of the one without a name,
    or of Blender's "Combined"; else Y or the only channel.

    Other channels (depth, alpha, normals) are no part of it. Raises InputError where there is no picture, or several.
    """
    parts = list(_parts(path))
    layers = [(index, spec, layer, found) for index, spec in parts for layer, found in _layers(spec).items()]
    coloured = [(index, spec, layer, found) for index, spec, layer, found in layers if {"R", "G", "B"} <= found.keys()]
    if coloured:
        named = [_called(spec, layer) for _, spec, layer, _ in coloured]
        for wanted in (named, [name for name in named if not name], [name for name in named if _is_whole(name)]):
            if len(wanted) == 1:
                index, spec, _, found = coloured[named.index(wanted[0])]
                return Part(index, spec, (found["R"], found["G"], found["B"]))
        found_names = ", ".join(name or "one without a name" for name in named)
        raise InputError(path, f"an EXR of several pictures ({found_names})", _EXPECTED)
    grey = [
        (index, spec, found["Y"]) for index, spec, _, found in layers if "Y" in found and not {"RY", "BY"} & {*found}
    ]
    if not grey:
        grey = [(index, spec, 0) for index, spec in parts if spec.nchannels == 1]
    if len(grey) == 1:
        index, spec, channel = grey[0]
        return Part(index, spec, (channel,))
    channels = ", ".join(name for _, spec in parts for name in spec.channelnames)
    raise InputError(path, f"an EXR with the channels {channels}", _EXPECTED)


def _parts(path: Path) -> Iterator[tuple[int, Any]]:
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        raise InputError(path, f"no readable image ({first_line(oiio.geterror)})", "an EXR file")
    index = 0
    while opened.seek_subimage(index, 0):
        yield index, opened.spec()
        index += 1
    opened.close()


def _layers(spec: Any) -> dict[str, dict[str, int]]:
    """Indices of channels by the layer's name, which stands before the last dot, and the channel's."""
    layers: dict[str, dict[str, int]] = {}
    for index, name in enumerate(spec.channelnames):
        layer, _, channel = name.rpartition(".")
        layers.setdefault(layer, {})[channel.upper()] = index
    return layers


def _called(spec: Any, layer: str) -> str:
    """The layer's name, else the part's where a file has several parts."""
    several = spec.get_int_attribute("oiio:subimages", 1) > 1
    return layer or (spec.get_string_attribute("name") if several else "")


def _is_whole(name: str) -> bool:
    return name.rpartition(".")[2].lower() == _WHOLE
