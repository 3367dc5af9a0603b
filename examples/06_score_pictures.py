"""Score images of a dataset's test views by another program. Here the blurred images themselves are scored.

python examples/06_score_pictures.py
"""

from pathlib import Path

import dofbench


def main(folder: Path = Path("data/example"), pictures: Path = Path("data/example/images")) -> None:
    """folder: a dataset. pictures: a folder with VIEW.png of every test view, meant to be all in focus."""
    dataset = dofbench.Dataset.load(folder)
    metrics = [name for name, metric in dofbench.METRICS.items() if metric.needs == "images"]
    for view in dataset.test_views():
        picture = dofbench.read_image(pictures / f"{view.name}.png")
        scores = dofbench.score_image(picture, dataset.all_in_focus(view), metrics)
        print(view.name, ", ".join(f"{dofbench.METRICS[name].label} {value:.3f}" for name, value in scores.items()))


if __name__ == "__main__":
    main()
