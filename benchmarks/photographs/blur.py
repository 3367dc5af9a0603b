"""Does the blur error rank predictions by their lens, where they are displaced and of another exposure?

    python -m benchmarks.photographs.blur SCENE ... VIEWS

A folder is a scene of `make-scene` with several apertures and foci of one view, or a light field's views, which are
averaged over discs of its grid. Every third picture is a photograph in turn, all are predictions. Prints the mean over
photographs of Spearman's rank correlation between a score and the lens error δ_R, the mean error of CoC radii in px.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter, shift
from scipy.stats import spearmanr

from dofbench.core.files import read_json
from dofbench.core.images import from_8bit, read_exr, read_image, to_8bit
from dofbench.evaluation.scoring.photograph_scores import picture_blur, picture_scores
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles, shrink
from dofbench.evaluation.scoring.photographs.predict import recoloured_by
from dofbench.optics.tone import decode, encode

# name -> shift of predictions in px, their gain (linear), standard deviation of the photograph's noise in levels
CONDITIONS = {"as they are": (0, 1.0, 0), "1 px": (1, 1.05, 0), "2 px": (2, 1.05, 0), "1 px, noise": (1, 1.05, 2)}
WIDTHS, STEPS, HALF = (1, 3, 5, 7, 9, 13), (0.05, 0.2, 0.35, 0.5), 8  # discs' views across, focus in px a view, grid
EVERY = 3  # pictures for one photograph
Picture = tuple[np.ndarray, np.ndarray]  # linear image (H, W, 3), CoC radius (H, W) in px


def rendered(folder: Path) -> list[Picture]:
    """The lens images of the scene's first view."""
    every = read_json(folder / "scene.json")["lens_images"]
    lenses = [one for one in every if one["view"] == every[0]["view"]]
    depth = read_exr(folder / f"depth/{every[0]['view']}.exr").astype(np.float64)
    disparity = np.divide(1, depth, out=np.zeros_like(depth), where=depth > 0)
    radii = [np.abs(one["aperture_scene"] * (disparity - 1 / one["focus_scene"])) for one in lenses]
    return [(read_exr(folder / one["image"]), radius) for one, radius in zip(lenses, radii, strict=True)]


def averaged(folder: Path) -> list[Picture]:
    """Means of linear light over discs about the central view, each view displaced for the focus."""
    steps = range(-(max(WIDTHS) // 2), max(WIDTHS) // 2 + 1)
    files = {(row, column): folder / f"{row + HALF:02d}_{column + HALF:02d}.jpg" for row in steps for column in steps}
    views = {at: shrink(decode(read_image(file)), 2) for at, file in files.items()}

    def seen(at: tuple[int, int], step: float) -> np.ndarray:
        return shift(views[at], (-step * at[0], step * at[1], 0), mode="nearest").clip(0, 1)

    swept = np.linspace(-0.15, 0.72, 30)  # the light field's disparities
    corners = [(row, column) for row in (-4, 0, 4) for column in (-4, 0, 4)]
    spread = [np.var([encode(seen(at, step)) for at in corners], axis=0).sum(axis=2) for step in swept]
    disparity = swept[np.argmin([gaussian_filter(one, 2.0) for one in spread], axis=0)]
    found = []
    for width in WIDTHS:
        disc = [at for at in views if np.hypot(*at) <= width / 2]
        for step in STEPS:
            light = np.mean([seen(at, step) for at in disc], axis=0)
            found.append((light, (width - 1) / 2 * np.abs(disparity - step)))
    return found


def correlations(pictures: list[Picture], moved: int, gain: float, noise: float) -> Iterator[list[float]]:
    """Of PSNR, SSIM and the blur error, for each picture as the photograph; 1 if a score ranks as the lens error."""
    for number, (light, radius) in enumerate(pictures[::EVERY]):
        generator = np.random.default_rng(number)
        clean = encode(light.clip(0, 1))
        photograph = from_8bit(to_8bit((clean + generator.normal(0, noise / 255, clean.shape)).clip(0, 1)))
        tiles, rows = Tiles.of(*radius.shape), []
        for other, own in pictures:
            picture = gain * np.roll(other, moved * generator.choice([-1, 1]), axis=generator.integers(2))
            picture = recoloured_by(encode(picture.clip(0, 1)).astype(np.float32), photograph, tiles)
            scores = picture_scores(picture, photograph, "", tiles) | picture_blur(picture, photograph, tiles)
            rows.append([-scores["psnr"], -scores["ssim"], scores["photo_blur"], np.abs(own - radius).mean()])
        yield [float(spearmanr(score, np.array(rows)[:, 3])[0]) for score in np.array(rows).T[:3]]


def main(folders: tyro.conf.Positional[tuple[Path, ...]], /) -> None:
    """Print a row for each folder and condition."""
    for folder in folders:
        pictures = rendered(folder) if (folder / "scene.json").is_file() else averaged(folder)
        for name, condition in CONDITIONS.items():
            means = np.mean(list(correlations(pictures, *condition)), axis=0)
            print(f"| {folder.name} | {name} | {' | '.join(f'{mean:.2f}' for mean in means)} |", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
