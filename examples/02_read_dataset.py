"""Read the dataset of 01_make_dataset.py: training views and ground truth.

python examples/02_read_dataset.py
"""

from pathlib import Path

import dofbench


def main(folder: Path = Path("data/example")) -> None:
    """folder: a dataset with a known lens."""
    dataset = dofbench.Dataset.load(folder)

    seen = dataset.training_set()  # blurred training views, cameras, points: no lens, depth or test view
    camera = seen.views[0].camera
    print(f"{len(seen.views)} training views of {camera.width}x{camera.height} pixels and {len(seen.points)} points")

    for view in dataset.test_views():  # test views are for scoring only
        sharp, depth = dataset.all_in_focus(view), dataset.depth(view)  # (H, W, 3) encoded; (H, W) scene units
        nearest = depth[depth > 0].min()
        print(f"{view.name}: aperture {view.lens.aperture:g}, focus {view.lens.focus:g}", end=", ")
        print(f"in focus at {view.physical_lens.focus_depth:.2f}, nearest at {nearest:.2f} scene units", end=", ")
        print(f"circles up to {view.max_coc_px:.1f} px, mean of the sharp image {sharp.mean():.2f}")


if __name__ == "__main__":
    main()
