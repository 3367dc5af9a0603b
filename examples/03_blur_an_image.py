"""Blur an all-in-focus image by its depth: with the lens of the dataset, then with another lens.

python examples/03_blur_an_image.py
"""

from pathlib import Path

import dofbench


def main(folder: Path = Path("data/example"), out: Path = Path("data/refocused.png")) -> None:
    """folder: a dataset with a known lens. out: the image to write."""
    dataset = dofbench.Dataset.load(folder)
    view = max(dataset.views, key=lambda view: view.max_coc_px)  # the most blurred one
    sharp, depth = dataset.all_in_focus(view), dataset.depth(view)

    again = dofbench.defocus(sharp, depth, view.physical_lens)
    scores = dofbench.score_image(again.clip(0, 1), dataset.image(view), ["psnr"])
    print(f"{view.name}, blurred again: {scores['psnr']:.1f} dB from the dataset's own, which is rounded to 8 bits")

    lens = dofbench.Lens(aperture=1.0, focus=0.9)  # wide open, focused near
    refocused = dofbench.defocus(sharp, depth, lens, disparity_range=dataset.disparity_range)
    dofbench.write_png(out, refocused)
    print(out)


if __name__ == "__main__":
    main()
