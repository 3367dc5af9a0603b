"""A figure for a paper from a finished run: a view refocused, its depth, and errors.

python examples/07_paper_figure.py RESULT [figure.pdf]
"""

import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import dofbench


def main(result: Path, out: Path = Path("figure.pdf"), foci: tuple[float, ...] = (0.1, 0.5, 0.9)) -> None:
    """result: the run's folder. out: .pdf, .svg or .png. foci: normalised disparity, 0 far to 1 near."""
    run = dofbench.load_run(result)
    view = run.dataset.test_views()[0]
    truth, sharp = run.dataset.image(view), run.dataset.all_in_focus(view)
    all_in_focus = run.model.render(view.camera)
    own = run.model.render(view.camera, view.lens)

    panels = [("test view", truth), ("all in focus", all_in_focus.image)]
    panels += [(f"focus {focus:g}", run.model.render(view.camera, dofbench.Lens(2.0, focus)).image) for focus in foci]
    maps = [("disparity", 1 / np.where(all_in_focus.depth > 0, all_in_focus.depth, np.inf), "viridis", None)]
    maps += [(f"error, lens of the view: {decibels(own.image, truth):.1f} dB", error(own.image, truth), "magma", 0.25)]
    if sharp is not None:
        text = f"error, all in focus: {decibels(all_in_focus.image, sharp):.1f} dB"
        maps += [(text, error(all_in_focus.image, sharp), "magma", 0.25)]

    columns = 4
    rows = -(-(len(panels) + len(maps)) // columns)
    figure, axes = plt.subplots(rows, columns, figsize=(7.0, 7.0 / columns * rows * 0.9), layout="constrained")
    for axis in axes.flat:
        axis.axis("off")
    for axis, (title, image) in zip(axes.flat, panels, strict=False):
        axis.imshow(np.clip(image, 0, 1), interpolation="none")
        axis.set_title(title, fontsize=7)
    for axis, (title, values, colours, most) in zip(axes.flat[len(panels) :], maps, strict=False):
        axis.imshow(values, cmap=colours, vmin=0, vmax=most, interpolation="none")
        axis.set_title(title, fontsize=7)
    figure.savefig(out, dpi=300)
    plt.close(figure)
    print(out)


def error(image: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Mean absolute error over the channels; 0.25 is white in the figure."""
    return np.abs(np.clip(image, 0, 1) - truth).mean(axis=2)


def decibels(image: np.ndarray, truth: np.ndarray) -> float:
    """PSNR."""
    return float(-10 * np.log10(np.mean((np.clip(image, 0, 1) - truth) ** 2)))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(Path, sys.argv[2:3]))
