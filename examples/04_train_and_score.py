"""Train a method briefly on the dataset made by 01_make_dataset.py, and look at its scores.

python examples/04_train_and_score.py
"""

from pathlib import Path

import dofbench


def main(data: Path = Path("data/example"), out: Path = Path("results"), steps: int = 200) -> None:
    """data: a dataset. out: the folder of results. steps: number of training steps."""
    budget = dofbench.Budget(steps=steps)  # or seconds, or both
    asked = dofbench.RunSpec(method="dofgaussian", data=data, budget=budget, out=out)
    end = dofbench.run(asked)  # a finished result of the same request is reused

    result = dofbench.read_result(end.folder)
    print(f"{result.status} after {result.curve[-1].steps} steps")
    for column, value in result.scores.items():
        print(f"  {column}: {value:.4g}")
    for column, reason in result.left_out.items():
        print(f"  no {column}: {reason}")
    for lens in result.lens[:3]:
        print(f"  {lens.name}: aperture {lens.aperture:g}, learned {lens.aperture_estimated:.2f}", end="; ")
        print(f"focus {lens.focus:g}, learned {lens.focus_estimated:.2f}")


if __name__ == "__main__":
    main()
