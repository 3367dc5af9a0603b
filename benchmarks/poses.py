"""Accuracy of poses from shallow photographs: `dofbench reconstruct` compared with known cameras.

    python benchmarks/poses.py --data SCENES --rendered RENDERED --out reports/poses/poses.csv

Cases are named SET/PHOTOGRAPHS. For the two real shallow sets the reference is the model that came with them, made from
the same photographs, so errors are the difference of two reconstructions. For fern and flower the reference is LLFF's,
from sharp photographs of eight times the size; their shallow photographs are made here from the sharp ones. RENDERED
holds scenes by `make-scene` in RENDERED/scenes/NAME and datasets of them by `make-dataset --renderer thinlens` in
RENDERED/lens/NAME; their cameras are exact.
"""

from __future__ import annotations

import argparse
import csv
import json
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from unittest import mock

import numpy as np

from dofbench.compute.threads import configure_threads
from dofbench.core.cameras import Camera
from dofbench.core.files import replacing
from dofbench.core.progress import Silent
from dofbench.scenes import load_scene
from dofbench.scenes.colmap import find_model, read_model
from dofbench.scenes.reconstruction import features
from dofbench.scenes.reconstruction.reconstruct_options import Reconstruct
from dofbench.scenes.reconstruction.reconstructing import run
from dofbench.scenes.scene import Scene
from dofbench.synthesis import make_dataset
from dofbench.synthesis.dataset_options import MakeDataset

COLUMNS = (
    "case",
    "photographs",
    "options",
    "views",
    "registered",
    "features",
    "points",
    "reprojection_px",
    "rotation_median_deg",
    "rotation_max_deg",
    "position_median_percent",
    "position_max_percent",
    "focal_percent",
    "seconds",
)
# Variants measured on the real shallow sets: case, name, options of `measure`.
VARIED = {
    "shallow_chessking": (
        ("four-octaves", "four octaves, as COLMAP has them", {"octaves": 4}),
        ("global", "--mapping global", {"mapping": "global"}),
    ),
    "shallow_blowtorch": (("focal-known", "--sensor-width 36", {"size": 1600, "sensor_width": 36.0}),),
}


def pose_errors(found: Mapping[str, Camera], true: Mapping[str, Camera]) -> tuple[np.ndarray, np.ndarray]:
    """(N,) rotation errors, degrees, and (N,) position errors, shares of the cameras' extent, after a similarity.

    The rotation of the similarity is the chordal mean of the views' rotations, which is determined even for cameras in
    a line, unlike a fit to positions; scale and shift are least squares. Extent: the largest distance of a true centre
    from the mean centre.
    """
    names = sorted(found)
    ours = np.stack([found[name].camera_to_world for name in names])
    theirs = np.stack([true[name].camera_to_world for name in names])
    u, _, vt = np.linalg.svd(np.einsum("nij,nkj->ik", theirs[:, :3, :3], ours[:, :3, :3]))
    turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    left = np.einsum("nji,jk,nkl->nil", theirs[:, :3, :3], turn, ours[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(left, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    here = ours[:, :3, 3] @ turn.T
    a, b = here - here.mean(axis=0), theirs[:, :3, 3] - theirs[:, :3, 3].mean(axis=0)
    scale = (a * b).sum() / (a * a).sum()
    return angle, np.linalg.norm(scale * a - b, axis=1) / np.linalg.norm(b, axis=1).max()


def focal_lengths(root: Path, scene: Scene) -> dict[str, float]:
    """View -> focal length over width, of the layout's own camera, before undistortion."""
    folder = find_model(root) if scene.layout == "colmap" else None
    if folder is None:
        return {view.name: view.camera.fx / view.camera.width for view in scene.views}
    model = read_model(folder)
    return {Path(name).stem: lens.fx / lens.width for name, lens in zip(model.names, model.intrinsics, strict=True)}


def measure(
    case: str, root: Path, truth: Scene, work: Path, row: dict, *, octaves: int | None = None, **options
) -> dict:
    """Reconstruct the photographs in `root` with their poses ignored, and compare with `truth`.

    octaves: of the features' scale space; None for the command's default.
    """
    out = work / case.replace("/", "-")
    settings = Reconstruct(source=root, out=out, poses="ignore", **options)
    start = time.monotonic()
    count = features.octaves if octaves is None else lambda width, height: octaves
    with mock.patch.object(features, "octaves", count):
        outcome = run(settings, Silent(), say=print)
    seconds = time.monotonic() - start
    row = {"case": case, "views": len(truth.views), "registered": 0, "seconds": f"{seconds:.0f}", **row}
    if outcome.folder is None:
        return row
    content = json.loads((out / "reconstruct.json").read_text())
    found = {view.name: view.camera for view in load_scene(out).views}
    true = {view.name: view.camera for view in truth.views}
    angle, position = pose_errors(found, true)
    focal = focal_lengths(truth.root, truth)
    errors = [
        camera["focal"][0] / camera["width"] / focal[view] - 1
        for camera in content["cameras"]
        if "focal" in camera
        for view in camera["views"]
        if view in found
    ]
    return row | {
        "registered": len(found),
        "features": int(np.mean([view["features"] for view in content["views"]])),
        "points": content["points"],
        "reprojection_px": f"{content['mean_reprojection_error']:.3f}",
        "rotation_median_deg": f"{np.median(angle):.4f}",
        "rotation_max_deg": f"{angle.max():.4f}",
        "position_median_percent": f"{100 * np.median(position):.3f}",
        "position_max_percent": f"{100 * position.max():.3f}",
        "focal_percent": f"{100 * np.median(np.abs(errors)):.3f}",
    }


def cases(
    data: Path, rendered: Path | None, work: Path, width: int | None, wanted: Callable[[str], bool]
) -> Iterator[tuple[str, Path, Scene, dict, dict]]:
    """(case, folder, truth, columns, options) of all cases that exist and are wanted."""
    for name, usual in (("shallow_chessking", 1000), ("shallow_blowtorch", 530)):
        size = width or usual
        if (data / name).is_dir() and wanted(f"{name}/as-they-are"):
            text = {"photographs": "real, shallow", "options": f"--size {size}"}
            yield f"{name}/as-they-are", data / name, load_scene(data / name), text, {"size": size}
        for what, asked, settings in VARIED[name]:
            if (data / name).is_dir() and wanted(f"{name}/{what}"):
                settings = {"size": size, **settings}
                text = {"photographs": "real, shallow", "options": ", ".join((f"--size {settings['size']}", asked))}
                yield f"{name}/{what}", data / name, load_scene(data / name), text, settings
    width = width or 504
    for name in ("llff_fern", "llff_flower"):
        if (data / name).is_dir():
            truth = load_scene(data / name, images="images_8")
            sharp = {"photographs": "real, sharp", "options": f"{width} pixels wide"}
            if wanted(f"{name}/sharp"):
                yield f"{name}/sharp", data / name, truth, sharp, {"images": "images_8", "size": width}
            for aperture in filter(lambda aperture, name=name: wanted(f"{name}/shallow-{aperture}"), ("0.5", "1.0")):
                made = work / f"{name}-{aperture}"
                make_dataset(
                    MakeDataset(
                        scene=str(data / name),
                        out=made,
                        width=width,
                        depth="sfm",
                        focus=(0.2, 0.5, 0.8),
                        aperture=(float(aperture),),
                    ),
                    progress=Silent(),
                )
                text = {"photographs": f"made shallow, A {aperture}, F 0.2 0.5 0.8", "options": f"{width} pixels wide"}
                yield f"{name}/shallow-{aperture}", made / "images", truth, text, {}
    for scene in sorted((rendered / "scenes").iterdir()) if rendered is not None else []:
        truth = load_scene(scene)
        size = f"{truth.views[0].camera.width} pixels wide"
        if wanted(f"{scene.name}/sharp"):
            text = {"photographs": "rendered, pinhole", "options": size}
            yield f"{scene.name}/sharp", scene / "images", truth, text, {}
        for lens in sorted((rendered / "lens").glob(f"{scene.name}*")):
            optics = json.loads((lens / "lens.json").read_text())
            how = "through a thin lens" if optics["renderer"] == "thinlens" else f"and blurred by {optics['renderer']}"
            apertures, focus = ({f"{view[name]:g}" for view in optics["views"]} for name in ("aperture", "focus"))
            text = {
                "photographs": f"rendered {how}, A {' '.join(sorted(apertures))}, F {' '.join(sorted(focus))}",
                "options": size,
            }
            if wanted(f"{lens.name}/lens"):
                yield f"{lens.name}/lens", lens / "images", truth, text, {}


def main() -> None:
    """Measure the cases, adding a line to the table after each; cases that are in the table are skipped."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--rendered", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--width", type=int, help="of the real photographs, pixels; 1000, 530 and 504")
    parser.add_argument("--only", default="", help="cases whose names begin so")
    options = parser.parse_args()
    rows: list[dict] = []
    if options.out.is_file():
        with options.out.open(newline="") as stream:
            rows = list(csv.DictReader(stream))
    with tempfile.TemporaryDirectory() as work:

        def wanted(case: str) -> bool:
            return case.startswith(options.only) and case not in {row["case"] for row in rows}

        for case, folder, truth, text, settings in cases(
            options.data, options.rendered, Path(work), options.width, wanted
        ):
            rows.append(measure(case, folder, truth, Path(work), text, **settings))
            print(rows[-1], flush=True)
            _write(options.out, rows)


def _write(path: Path, rows: Sequence[dict]) -> None:
    with replacing(path) as temporary, temporary.open("w", newline="") as stream:
        table = csv.DictWriter(stream, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)


if __name__ == "__main__":
    configure_threads()
    main()
