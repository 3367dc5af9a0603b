"""Files damaged at random: bits, lengths, fields, numbers; and what this project makes of them.

A kind is a small folder of whole files, and the calls that read all of it.
"""

from __future__ import annotations

import json
import os
import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from made_up import cloud, frontal
from small_dataset import write_dataset

from dofbench.core.errors import InputError
from dofbench.core.image_files.exif import Exif, write_exif
from dofbench.core.images import write_exr, write_png
from dofbench.scenes import export, load_scene

WIDTH, HEIGHT, VIEWS = 40, 30, 4
_DEPTHS = ("exr", "png", "npy", "bin")
_TEXTS = (".json", ".toml", ".csv", ".txt")
# What no field expects; the last ones are written as they stand, since no value of Python's prints so.
_ODD: tuple[Any, ...] = (
    None,
    True,
    "",
    "x" * 300,
    "../../x",
    "/etc/passwd",
    "a\0b",
    "a\nb\x1b[31m",
    "\ud800",
    "<script>alert(1)</script>",
    -1,
    0,
    1e-300,
    1e38,
    1e300,
    -1e308,
    2**63,
    10**40,
    float("nan"),
    float("inf"),
    [],
    {},
    [[]],
    ["x"],
    {"x": None},
    "@digits@",
    "@deep@",
    "@long@",
)
_RAW = {"@digits@": "9" * 400, "@deep@": "[" * 20_000 + "]" * 20_000, "@long@": "9" * 5000}
_NUMBERS = (
    "-1",
    "0",
    "nan",
    "inf",
    "1e38",
    "1e308",
    "1e309",
    "9" * 11,
    "18446744073709551616",
    "x",
    "",
    "9" * 400,
)
_EXTREME = (b"\x00" * 4, b"\xff" * 4, b"\xff" * 8, b"\xff\xff\xff\x7f", b"\x00" * 7 + b"\x80", b"\x00\x00\x80\x7f")


def damage(folder: Path, chance: random.Random) -> str:
    """Damage one file of a folder, or two; returns what was done."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    done = []
    for _ in range(1 + (chance.random() < 0.2)):
        # Small files hold what decides; an image is chosen as often as one of them.
        file = chance.choice(files)
        if not file.is_file():
            continue
        kind = chance.random()
        if kind < 0.03:
            done.append(_swapped_kind(file, chance))
        elif kind < 0.08:
            other = chance.choice(files)
            if other.is_file():
                file.write_bytes(other.read_bytes())
            done.append(f"{file.name} holds {other.name}")
        elif file.suffix == ".json" and kind < 0.75 and (changed := _changed_json(file, chance)):
            done.append(f"{file.name}: {changed}")
        elif file.suffix in _TEXTS and kind < 0.85:
            done.append(f"{file.name}: {_changed_text(file, chance)}")
        else:
            done.append(f"{file.name}: {_changed_bytes(file, chance)}")
    return "; ".join(done)


def _swapped_kind(file: Path, chance: random.Random) -> str:
    """A file that has become something else than a regular file, or none of any name's."""
    what = chance.choice(("fifo", "folder", "circle", "device", "name"))
    file.unlink()
    if what == "fifo":
        os.mkfifo(file)
    elif what == "folder":
        file.mkdir()
    elif what == "circle":
        file.symlink_to(file.name)
    elif what == "device":
        file.symlink_to("/dev/zero")
    else:
        os.close(os.open(os.fsencode(file.parent) + b"/S\xe4ule" + os.fsencode(file.suffix), os.O_CREAT))
    return f"{file.name} is a {what}"


def _changed_json(file: Path, chance: random.Random) -> str:
    try:
        data = json.loads(file.read_text(encoding="utf-8"))
    except (ValueError, RecursionError):
        return ""
    places: list[tuple[Any, Any]] = []
    stack = [data]
    while stack:
        node = stack.pop()
        keys = list(node) if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ()
        places += [(node, key) for key in keys]
        stack += [node[key] for key in keys]
    if not places:
        return ""
    node, key = chance.choice(places)
    how = chance.random()
    value = chance.choice(_ODD)
    if how < 0.2:
        del node[key]
        said = f"without {key!r}"
    elif how < 0.3 and isinstance(node, dict):
        node[str(value)] = node.pop(key)
        said = f"{key!r} called {value!r:.30}"
    elif how < 0.4 and isinstance(node, list):
        node.append(node[key])
        said = f"{key!r} twice"
    elif how < 0.5:
        other, place = chance.choice(places)
        node[key], said = other[place], f"{key!r} holds {place!r}"
    else:
        node[key], said = value, f"{key!r} is {value!r:.30}"
    try:
        text = json.dumps(data)
    except (ValueError, RecursionError):  # a part put into itself
        return ""
    for mark, raw in _RAW.items():
        text = text.replace(f'"{mark}"', raw)
    file.write_text(text, encoding="utf-8")
    return said


def _changed_text(file: Path, chance: random.Random) -> str:
    lines = file.read_bytes().split(b"\n")
    row = chance.randrange(len(lines))
    how = chance.random()
    if how < 0.2:
        del lines[row]
        said = f"without line {row + 1}"
    elif how < 0.3:
        lines.insert(row, lines[row])
        said = f"line {row + 1} twice"
    else:
        words = lines[row].split(b" ")
        word = chance.randrange(len(words))
        value = chance.choice(_NUMBERS).encode() if chance.random() < 0.8 else b"S\xe4ule"
        words[word] = value
        lines[row] = b" ".join(words)
        said = f"line {row + 1}, word {word + 1} is {value[:20]!r}"
    file.write_bytes(b"\n".join(lines))
    return said


def _changed_bytes(file: Path, chance: random.Random) -> str:
    content = bytearray(file.read_bytes())
    if not content:
        return "is empty"
    at, how = chance.randrange(len(content)), chance.random()
    # Headers and counts are at the start.
    at = at if chance.random() < 0.5 else min(len(content) - 1, int(chance.expovariate(1 / 40)))
    if how < 0.45:
        for _ in range(chance.choice((1, 1, 2, 8))):
            content[at] ^= 1 << chance.randrange(8)
            at = chance.randrange(len(content))
        said = "bits flipped"
    elif how < 0.7:
        extreme = chance.choice(_EXTREME)
        content[at : at + len(extreme)] = extreme
        said = f"{extreme.hex()} at byte {at}"
    elif how < 0.85:
        del content[at:]
        said = f"cut short after {at} bytes"
    elif how < 0.9:
        content = bytearray()
        said = "emptied"
    elif how < 0.95:
        del content[at : at + chance.choice((1, 4, 8, 64))]
        said = f"bytes lost at {at}"
    else:
        content += chance.randbytes(chance.choice((1, 8, 1000)))
        said = "garbage appended"
    file.write_bytes(bytes(content))
    return said


def _make_scene(folder: Path, layout: str) -> None:
    """A small scene: a wall of waves with depth before four cameras."""
    images = folder / ("images_8" if layout in ("llff", "dofnerf") else "images")
    cameras = [frontal(WIDTH, HEIGHT, 50.0, (0.1 * index, 0.0, 0.0)) for index in range(VIEWS)]
    names = [f"v{index}.png" for index in range(VIEWS)]
    waves = np.sin(np.arange(WIDTH * HEIGHT * 3).reshape(HEIGHT, WIDTH, 3) / 7) * 0.4 + 0.5
    for stack in ("f11", "f4_bak", "f4_obj") if layout == "dofnerf" else ("",):
        for name in names:
            write_png(images / stack / name, waves.astype(np.float32))
    across, down = np.meshgrid(np.linspace(-0.5, 0.5, 4), np.linspace(-0.4, 0.4, 3))
    xyz = np.stack([across.ravel(), down.ravel(), np.full(across.size, 3.0)], axis=1)
    points = cloud(xyz, [np.arange(VIEWS) for _ in xyz], rgb=np.full(xyz.shape, 0.5))
    export.write_colmap(folder, names, cameras, points)
    if layout == "colmap text":
        import pycolmap

        model = pycolmap.Reconstruction(str(folder / "sparse/0"))
        model.write_text(str(folder / "sparse/0"))
        for file in (folder / "sparse/0").glob("*.bin"):
            file.unlink()
    elif layout == "colmap rigs":
        import pycolmap

        pycolmap.Reconstruction(str(folder / "sparse/0")).write_binary(str(folder / "sparse/0"))
    elif layout == "nerfstudio":
        for name in names:
            write_exr(folder / "depth" / f"{Path(name).stem}.exr", np.full((HEIGHT, WIDTH), 3.0, np.float32))
        export.write_transforms(
            folder / "transforms.json",
            [f"images/{name}" for name in names],
            cameras,
            depth_paths=[f"depth/{Path(name).stem}.exr" for name in names],
            splits=["test", "train", "train", "train"],
            ply_path="points.ply" if folder.name.endswith("ply") else None,
        )
    elif layout in ("llff", "dofnerf", "deblurnerf"):
        export.write_poses_bounds(folder / "poses_bounds.npy", cameras, np.full((VIEWS, 2), (2.0, 4.0)))
        if layout == "deblurnerf":
            (folder / "hold=2").touch()
    write_exif(folder, {"v0": Exif(f_number=2.0, focal_length=50.0), "v1": Exif(f_number=4.0, camera="A")})
    (images / "exif.csv").write_text("name,f_number,iso,time\nv2.png,2.8,100,2021:03:04 10:48:15\nv3.png,,200,\n")


def _use_scene(folder: Path, layout: str) -> None:
    asked = "deblurnerf" if layout == "deblurnerf" else "auto"
    scene = load_scene(folder, layout=asked)
    for view in scene.views:
        view.image()
        if view.depth is not None:
            view.depth()
    scene.training_set()


def _use_dataset(folder: Path) -> None:
    from dofbench.datasets.format.dataset import Dataset
    from dofbench.datasets.synthesis.verify import check_dataset

    dataset = Dataset.load(folder)
    for view in dataset.views:
        dataset.image(view.name), dataset.depth(view.name), dataset.all_in_focus(view.name)
    dataset.training_set()
    check_dataset(folder)


def _make_files(folder: Path) -> None:
    """Single files: depth maps, points, lenses, colours, models, presets and cards."""
    import torch

    from dofbench.core.lens import PhysicalLens
    from dofbench.training.common.lens_file import write_lenses
    from dofbench.training.common.photograph_colours import write_colours
    from dofbench.training.gaussians.model import PARAMETERS, Gaussians
    from dofbench.training.gaussians.splats import write_splats

    folder.mkdir(parents=True)
    depth = np.linspace(1.0, 5.0, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    write_exr(folder / "a.exr", depth)
    write_png(folder / "a.png", np.repeat(depth[..., None] / 6, 3, axis=2), bits=16)
    np.save(folder / "a.npy", depth)
    (folder / "a.bin").write_bytes(f"{WIDTH}&{HEIGHT}&1&".encode() + depth.tobytes())
    header = "ply\nformat {} 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
    colours = "property uchar red\nproperty uchar green\nproperty uchar blue\nend_header\n"
    (folder / "ascii.ply").write_text(header.format("ascii") + colours + "1 2 3 4 5 6\n" * 5)
    table = np.zeros(5, [(axis, "<f4") for axis in "xyz"] + [(colour, "u1") for colour in ("r", "g", "b")])
    (folder / "binary.ply").write_bytes((header.format("binary_little_endian") + colours).encode() + table.tobytes())
    rows = {"means": (3,), "log_scales": (3,), "quaternions": (4,), "sh_dc": (3,), "sh_rest": (3, 3)}
    model = Gaussians({name: torch.ones(6, *rows.get(name, ())) for name in PARAMETERS})
    model.save(folder / "model.npz")
    write_splats(folder / "splats.ply", model)
    write_lenses(folder / "lenses.json", {"v0": PhysicalLens(1.0, 0.2, 40)}, {"gamma": 2.2}, {})
    write_colours(folder / "colours.json", {"v0": np.eye(3, 4)})


def _use_files(folder: Path) -> None:
    from dofbench.scenes.depth_files import read_depth
    from dofbench.scenes.ply import read_ply
    from dofbench.training.common.lens_file import read_lenses
    from dofbench.training.common.photograph_colours import read_colours
    from dofbench.training.gaussians.model import Gaussians
    from dofbench.training.gaussians.splats import read_splats

    reads: list[Callable[[], object]] = [lambda file=folder / f"a.{end}": read_depth(file, 1.0) for end in _DEPTHS]
    reads += [lambda: read_ply(folder / "ascii.ply"), lambda: read_ply(folder / "binary.ply")]
    reads += [lambda: Gaussians.load(folder / "model.npz"), lambda: read_splats(folder / "splats.ply")]
    reads += [lambda: read_lenses(folder / "lenses.json", {"gamma"}), lambda: read_colours(folder / "colours.json")]
    refused = []
    for read in reads:
        try:
            read()
        except InputError as error:
            refused.append(error)
    if refused:
        raise refused[0]


def _make_results(folder: Path) -> None:
    """Results of an older schema, as reports still read them."""
    for file in sorted((Path(__file__).parent / "harness" / "old_results").glob("*.json")):
        (folder / "results" / file.stem).mkdir(parents=True)
        (folder / "results" / file.stem / "result.json").write_bytes(file.read_bytes())


def _use_results(folder: Path) -> None:
    from rich.console import Console

    from dofbench.reporting import report_files
    from dofbench.reporting.report_options import Report

    vars(report_files)["write_curves"] = lambda *_: {}  # figures take most of the time
    settings = Report(folder / "results", folder / "out", pictures=False)
    written = report_files.write_report(settings, Console(quiet=True))
    if written.unreadable:
        raise InputError(folder, written.unreadable[0], "results")


KINDS: dict[str, tuple[Callable[[Path], None], Callable[[Path], None]]] = {}
for _layout in ("nerfstudio", "colmap binary", "colmap rigs", "colmap text", "llff", "deblurnerf", "dofnerf"):
    KINDS[_layout] = (
        lambda folder, layout=_layout: _make_scene(folder, layout),
        lambda folder, layout=_layout: _use_scene(folder, layout),
    )
KINDS["dataset"] = (lambda folder: (write_dataset(folder), None)[1], _use_dataset)
KINDS["files"] = (_make_files, _use_files)
KINDS["results"] = (_make_results, _use_results)
