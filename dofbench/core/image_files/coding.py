"""How the values of an image file stand for colours: encoded for display or linear light, and in which colour space.

Everything here is read from the header of a file that OpenImageIO opens.
"""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from dofbench.core.errors import InputError, first_line
from dofbench.core.image_files.exr_parts import picture_part
from dofbench.core.image_files.icc import profile_kind, profile_name
from dofbench.core.image_files.primaries import ADOBE_GAMMA, ADOBE_RGB, BT_2020, DISPLAY_P3, SRGB, Chromaticities

_CONVERTED = "an sRGB or linear image; convert it first"
# Of a PNG that says 1 / 2.2, as most do that say anything, and of sRGB: the same, by the PNG specification (13.13).
_USUAL_GAMMA, _NEAR = 2.2, 0.02
# Programs write sRGB's chromaticities with three digits or four.
_SAME_PLACE = 1e-3
_OTHER = "other primaries"
_LARGEST_PROFILE = 2**24
# ITU-T H.273, tables 2 and 3: the code points of cICP and nclx.
_PRIMARIES: dict[int, tuple[str, Chromaticities]] = {
    1: ("sRGB", SRGB),
    2: ("sRGB", SRGB),
    9: ("BT.2020", BT_2020),
    12: ("Display P3", DISPLAY_P3),
}
_DISPLAY_CURVES, _LINEAR_CURVE = (1, 2, 6, 13, 14, 15), 8
_CURVE_NAMES = {16: "PQ (HDR)", 18: "HLG (HDR)"}
# TIFF 6.0 and its supplements, tag 262: grey (0, 1), RGB, palette, YCbCr; OpenImageIO makes RGB of the last two.
_TIFF_KINDS = (0, 1, 2, 3, 6)
_TIFF_NAMES = {5: "inks (CMYK)", 8: "CIELAB", 9: "CIELAB (ICC)", 10: "CIELAB (ITU)", 32844: "LogL", 32845: "LogLuv"}
_TIFF_INKS = 5
# The bits of tag 254 of a page that is a smaller copy or a mask of another.
_COPY_OR_MASK = 1 | 4


@dataclass(frozen=True)
class Coding:
    """What the values of an image file are.

    linear: proportional to light, and perhaps above 1; otherwise encoded for display, in [0, 1]. name: of the colour
    space, for a note. One of four says how values become sRGB's: profile, an ICC profile; space, a name of
    OpenImageIO's; inks, for CMYK; or chromaticities and gamma, where `linear ** (1 / gamma)` was stored (0: sRGB's
    curve).
    """

    linear: bool = False
    name: str = "sRGB"
    profile: bytes = b""
    space: str = ""
    inks: bool = False
    chromaticities: Chromaticities = SRGB
    gamma: float = 0.0

    @property
    def is_usual(self) -> bool:
        """Whether the stored values are taken as they are: sRGB, or linear light with its primaries."""
        same = self.chromaticities == SRGB and (self.linear or self.gamma == 0)
        return same and not (self.profile or self.space or self.inks)


USUAL: Final = Coding()
LIGHT: Final = Coding(linear=True, name="linear light", gamma=1.0)


def coding_of(path: Path) -> Coding:
    """The coding of an image file that OpenImageIO can open; `USUAL` for any other.

    Raises InputError for a file that is understood only in part: HDR encodings, Lab, inks without a profile, several
    pages, a damaged ICC profile, a colour space of unknown name.
    """
    try:
        return _of_header(path)
    except UnicodeDecodeError as error:
        raise InputError(path, f"a damaged header ({error.reason})", "an image file") from None


def _of_header(path: Path) -> Coding:
    import OpenImageIO as oiio

    opened = oiio.ImageInput.open(str(path))
    if opened is None:
        first_line(oiio.geterror)  # else it is kept, and printed when the program ends
        return USUAL
    spec, kind = opened.spec(), opened.format_name()
    if kind == "tiff":
        _check_pages(path, opened)
    opened.close()
    if kind == "tiff" and (found := spec.get_int_attribute("tiff:PhotometricInterpretation", 2)) not in _TIFF_KINDS:
        if found != _TIFF_INKS:
            raise InputError(path, f"a TIFF of {_TIFF_NAMES.get(found, f'photometric {found}')}", _CONVERTED)
        return _inks(path)
    if kind == "jpeg" and spec.get_string_attribute("jpeg:ColorSpace") in ("CMYK", "YCCK"):
        return _inks(path)
    if kind == "webp" and spec.get_int_attribute("oiio:Movie"):
        raise InputError(path, "an animation", "an image of one frame")
    if kind == "openexr":
        return _of_exr(path, picture_part(path).spec)
    codes = spec.getattribute("CICP")
    if codes is not None:
        return coding_of_codes(path, int(codes[0]), int(codes[1]))
    floating = str(spec.format) in ("half", "float", "double")
    if kind == "jpeg" and floating:
        return _of_base(path)
    profile = spec.getattribute("ICCProfile")
    if profile is not None:
        return of_profile(path, bytes(bytearray(profile)))
    if kind == "png":
        return _of_png(path, spec)
    if kind == "jpeg" and spec.get_int_attribute("Exif:ColorSpace") == 65535 and _says_adobe(path):
        return Coding(name="Adobe RGB", chromaticities=ADOBE_RGB, gamma=ADOBE_GAMMA)
    return LIGHT if floating else USUAL


def coding_of_codes(path: Path, primaries: int, curve: int) -> Coding:
    """The coding by the numbers of ITU-T H.273 for primaries and for the transfer curve. Raises InputError for HDR."""
    if primaries not in _PRIMARIES or curve not in (*_DISPLAY_CURVES, _LINEAR_CURVE):
        name = _PRIMARIES[primaries][0] if primaries in _PRIMARIES else f"primaries {primaries}"
        found = f"colours in {name} with {_CURVE_NAMES.get(curve, f'the transfer curve {curve}')}"
        raise InputError(path, f"{found} (code points of ITU-T H.273)", _CONVERTED)
    name, chromaticities = _PRIMARIES[primaries]
    if curve == _LINEAR_CURVE:
        return Coding(True, _linear_name(name), chromaticities=chromaticities, gamma=1.0)
    return Coding(name=name, chromaticities=chromaticities)


def of_profile(path: Path, profile: bytes) -> Coding:
    """The coding by an ICC profile. Raises InputError for a damaged one, or one that can't be an RGB image's."""
    try:
        kind = profile_kind(profile)
    except ValueError as error:
        expected = "an ICC profile that can be read and fits; or the image converted to sRGB, without one"
        raise InputError(path, str(error), expected) from None
    if kind == "sRGB":
        return USUAL
    name = profile_name(profile)
    return Coding(kind == "linear", _linear_name(name) if kind == "linear" else name, profile)


def _linear_name(name: str) -> str:
    return LIGHT.name if name == USUAL.name else f"{LIGHT.name} in {name}"


def _check_pages(path: Path, opened: Any) -> None:
    pages, copies = 1, 0
    while opened.seek_subimage(pages, 0):
        copies += bool(opened.spec().get_int_attribute("tiff:subfiletype") & _COPY_OR_MASK)
        pages += 1
    opened.seek_subimage(0, 0)
    if pages - copies > 1:
        raise InputError(path, f"a TIFF of {pages - copies} pages", "an image of one page")


def _of_base(path: Path) -> Coding:
    """The coding of a JPEG with a gain map, of which OpenImageIO makes HDR and `read_image` takes the base."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            profile = image.info.get("icc_profile")
    except (OSError, ValueError) as error:
        raise InputError(path, f"no readable image ({error})", _CONVERTED) from None
    return of_profile(path, profile) if profile else USUAL


def _inks(path: Path) -> Coding:
    from PIL import Image

    try:
        with Image.open(path) as image:
            profile = image.info.get("icc_profile") or b""
    except (OSError, ValueError) as error:
        raise InputError(path, f"no readable image of inks ({error})", _CONVERTED) from None
    if not profile:
        raise InputError(path, "an image of inks (CMYK) without an ICC profile", _CONVERTED)
    return Coding(name=f"CMYK ({profile_name(profile)})", profile=profile, inks=True)


def _of_exr(path: Path, spec: Any) -> Coding:
    stated = spec.get_string_attribute("oiio:ColorSpace") or spec.get_string_attribute("colorInteropID")
    chromaticities = spec.getattribute("chromaticities")
    if stated and stated.lower() not in ("unknown", "data", "raw"):
        return _of_name(path, stated)
    if chromaticities is None:
        return LIGHT
    found = _chromaticities([float(value) for value in chromaticities])
    return LIGHT if found == SRGB else Coding(True, _linear_name(_OTHER), chromaticities=found, gamma=1.0)


def _of_name(path: Path, stated: str) -> Coding:
    import OpenImageIO as oiio

    config = oiio.ColorConfig("ocio://default")
    try:
        name = config.resolve(stated)
    except TypeError:  # a name that isn't UTF-8
        name = ""
    if "PQ" in name or "HLG" in name or "HDR" in name or name not in config.getColorSpaceNames():
        raise InputError(path, f"the colour space {stated!r}", "one that OpenImageIO knows, such as linear or sRGB")
    if name.startswith("sRGB Encoded Rec.709") or name.startswith("sRGB - "):
        return USUAL
    if name.startswith("Linear Rec.709"):
        return LIGHT
    linear = bool(config.isColorSpaceLinear(name))
    return Coding(linear, f"{LIGHT.name} in {name}" if linear else name, space=name)


def _of_png(path: Path, spec: Any) -> Coding:
    chunks = _png_chunks(path)
    if b"iCCP" in chunks:  # libpng drops a profile that it finds a fault with, and says nothing
        return of_profile(path, _unpacked(chunks[b"iCCP"]))
    if b"sRGB" in chunks:
        return USUAL
    chromaticities = SRGB
    if len(place := chunks.get(b"cHRM", b"")) == 32:
        # The PNG specification, 11.3.2.1: white, red, green, blue, in units of 1e-5.
        numbers = [int.from_bytes(place[at : at + 4], "big") / 1e5 for at in range(0, 32, 4)]
        chromaticities = _chromaticities([*numbers[2:], *numbers[:2]])
    stored = int.from_bytes(chunks.get(b"gAMA", b""), "big") / 1e5
    gamma = 1 / stored if stored > 0 else 0.0
    if abs(gamma - _USUAL_GAMMA) <= _NEAR:
        gamma = 0.0
    name = USUAL.name if chromaticities == SRGB else _OTHER
    if abs(gamma - 1) <= _NEAR:
        return Coding(True, _linear_name(name), chromaticities=chromaticities, gamma=1.0)
    return Coding(name=f"{name} with gamma {gamma:.3g}" if gamma else name, chromaticities=chromaticities, gamma=gamma)


def _chromaticities(found: Sequence[float]) -> Chromaticities:
    """Those found, x and y of red, green, blue, white; `SRGB` where they differ from it by rounding alone."""
    if len(found) != len(SRGB) or all(abs(a - b) < _SAME_PLACE for a, b in zip(found, SRGB, strict=True)):
        return SRGB
    a, b, c, d, e, f, g, h = found
    return (a, b, c, d, e, f, g, h)


def _png_chunks(path: Path) -> dict[bytes, bytes]:
    """The chunks before the pixels of a PNG that say something about colour, by their names."""
    chunks: dict[bytes, bytes] = {}
    with path.open("rb") as stream:
        stream.seek(8)
        while len(head := stream.read(8)) == 8 and head[4:] not in (b"IDAT", b"IEND"):
            length = int.from_bytes(head[:4], "big")
            if head[4:] in (b"sRGB", b"gAMA", b"cHRM", b"iCCP"):
                chunks[head[4:]] = stream.read(length)
            else:
                stream.seek(length, 1)
            stream.seek(4, 1)
    return chunks


def _unpacked(chunk: bytes) -> bytes:
    """The profile in an iCCP chunk: a name, its end, one byte for the method, deflated data; empty where damaged."""
    try:
        return zlib.decompressobj().decompress(chunk.partition(b"\0")[2][1:], _LARGEST_PROFILE)
    except zlib.error:
        return b""


def _says_adobe(path: Path) -> bool:
    """Whether a camera's JPEG says by DCF's index R03 that it is in Adobe RGB, which it does without an ICC profile."""
    from PIL import Image

    try:
        with Image.open(path) as image:
            index = image.getexif().get_ifd(0xA005).get(1)
    except (OSError, ValueError, SyntaxError, KeyError):
        return False
    return str(index).strip("\0 ").upper() == "R03"
