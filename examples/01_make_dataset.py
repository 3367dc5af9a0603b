"""Make a dataset of the built-in scene, and check it.

python examples/01_make_dataset.py
"""

from pathlib import Path

import dofbench


def main(out: Path = Path("data/example"), width: int = 160) -> None:
    """out: the dataset's folder. width: width of its images, pixels."""
    options = dofbench.MakeDataset(width=width, out=out)  # every option of `dofbench make-dataset` by its name
    folder = dofbench.make_dataset(options)  # continues where an interrupted call stopped

    problems = dofbench.check_dataset(folder)  # checks all checksums and lenses, and recomputes a part of the blur
    print(f"{folder} is a valid dataset" if not problems else "\n".join(problems))


if __name__ == "__main__":
    main()
