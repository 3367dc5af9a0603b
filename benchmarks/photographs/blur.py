"""Does `photo_blur` rank predictions by the error of their lens, where they are displaced and of another exposure?

    python -m benchmarks.photographs.blur FOLDER ...

A folder is a light field, or a scene of `make-scene` with several apertures and foci of one view. All images of a view
are predictions of every third one of them, the photographs. The lens error of a prediction is the mean absolute
difference of its CoC radii from the photograph's, px. Prints Spearman's rank correlation of scores with it, the mean
over photographs and the least of them; and that of `photo_blur_bias` with the difference of mean radii. 1 is best.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import tyro
from scipy.ndimage import gaussian_filter
from scipy.stats import spearmanr

from dofbench.core.images import cropped, from_8bit, to_8bit
from dofbench.evaluation.renderer.rendered import rendered_cases
from dofbench.evaluation.scoring.photograph_scores import picture_blur, picture_scores
from dofbench.evaluation.scoring.photographs.image_tiles import Tiles
from dofbench.evaluation.scoring.photographs.predict import recoloured_by
from dofbench.optics.tone import decode, encode
from dofbench.scenes.light_field.average import averaged
from dofbench.scenes.light_field.grid import is_grid, read_grid
from dofbench.scenes.light_field.rig import Rig
from dofbench.scenes.light_field.window import reach_of, weights

RADII, FOCI = (1.5, 2.5, 4.0, 5.5, 7.0), (0.1, 0.35, 0.65, 0.9)  # grid steps; share of the parallax' range
EVERY = 3  # images for one photograph
BORDER = 2  # px cropped, as much as predictions are displaced
SCORES = ("PSNR", "SSIM", "photo_blur", "photo_blur_bias")


@dataclass(frozen=True)
class Condition:
    """Other errors of the predictions. shift: px, along a random axis. gain: of linear light, in the middle; it falls
    and rises by `slope` towards the left and right border. noise: standard deviation of the photograph's, of 255.
    grain, soft: the predictions' own noise and Gaussian blur, px, each up to this."""

    shift: int = 0
    gain: float = 1.0
    slope: float = 0.0
    noise: float = 0.0
    grain: float = 0.0
    soft: float = 0.0


CONDITIONS = {
    "none": Condition(),
    "1 px": Condition(1, 1.05),
    "2 px": Condition(2, 1.05),
    "1 px, light ±10 %": Condition(1, 1.05, slope=0.1),
    "1 px, noise 2/255": Condition(1, 1.05, noise=2.0),
    "grain up to 15/255": Condition(grain=15.0),
    "softness up to 1 px": Condition(soft=1.0),
    "1 px, softness up to 1 px": Condition(1, 1.05, soft=1.0),
}


@dataclass(frozen=True, eq=False)
class Image:
    """light: (H, W, 3), linear. radius: (H, W), of the CoC, px."""

    light: np.ndarray
    radius: np.ndarray


def rendered(folder: Path) -> dict[str, list[Image]]:
    """The images of a scene of `make-scene`, by view."""
    found: dict[str, list[Image]] = {}
    for case in rendered_cases(folder):
        truth = case.make()
        image = Image(decode(truth.photograph), np.abs(truth.signed_radius))
        found.setdefault(f"{case.name} {case.view}", []).append(image)
    return found


def refocused(folder: Path, width: int) -> list[Image]:
    """Averages of a light field's views around its centre, in windows of `RADII` focused at `FOCI`."""
    grid = read_grid(folder)
    rig, scale = Rig.of(grid), width / grid.size[0]
    far, near = rig.parallax
    parallax, found = rig.swept((0, 0), width).disparity, []
    for radius, focus in product(np.array(RADII) * grid.step, far + np.array(FOCI) * (near - far)):
        around = range(-reach_of(radius / grid.step), reach_of(radius / grid.step) + 1)
        positions = {at: np.array(rig.motion((0, 0), at, grid.size[0])) for at in product(around, around)}
        shares = weights(radius, grid.step, positions)
        assert shares is not None, f"too few views within {radius / grid.step} steps"
        shifts = {at: focus * np.array(rig.motion((0, 0), at, width)) for at in shares}
        views = ((grid.read(at, width), tuple(shifts[at]), share) for at, share in shares.items())
        found.append(Image(averaged(views), radius * scale * np.abs(parallax - focus)))
    return found


def correlations(images: list[Image], condition: Condition) -> Iterator[list[float]]:
    """For each photograph, the rank correlations of `SCORES`."""
    for number, true in enumerate(images[::EVERY]):
        generator = np.random.default_rng(number)
        clean = encode(true.light)
        noisy = (clean + generator.normal(0, condition.noise / 255, clean.shape)).clip(0, 1)
        photograph = cropped(from_8bit(to_8bit(noisy)), BORDER)
        tiles = Tiles.of(*photograph.shape[:2])
        rows = []
        for image in images:
            gain = condition.gain * (1 + condition.slope * np.linspace(-1, 1, clean.shape[1]))[:, None]
            moved = np.roll(image.light, condition.shift * generator.choice([-1, 1]), axis=generator.integers(2))
            moved = gaussian_filter(moved, generator.uniform(0, condition.soft), axes=(0, 1))
            grain = generator.normal(0, generator.uniform(0, condition.grain) / 255, clean.shape)
            picture = cropped((encode((gain * moved).clip(0, 1)) + grain).astype(np.float32), BORDER)
            picture = recoloured_by(picture, photograph, tiles)
            scores = picture_scores(picture, photograph, "", tiles) | picture_blur(picture, photograph, tiles)
            error = np.abs(image.radius - true.radius).mean()
            goals = (-error, -error, error, true.radius.mean() - image.radius.mean())
            rows.append([*zip(scores.values(), goals, strict=True)])
        yield [float(spearmanr(score, goal)[0]) for score, goal in np.array(rows).transpose(1, 2, 0)]


def main(folders: tyro.conf.Positional[tuple[Path, ...]], /, width: int = 350) -> None:
    """Print a row for each view and condition. width: of a light field's images, px."""
    print(f"| images | other errors | {' | '.join(SCORES)} |")
    for folder in folders:
        views = {folder.name: refocused(folder, width)} if is_grid(folder) else rendered(folder)
        for name, (title, condition) in product(views, CONDITIONS.items()):
            found = np.array([*correlations(views[name], condition)])
            cells = (f"{mean:.2f} ({least:.2f})" for mean, least in zip(found.mean(0), found.min(0), strict=True))
            print(f"| {name} | {title} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
