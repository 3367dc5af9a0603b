"""The commands `check`, `score`, `scenes` and `methods`: options, and the call that each makes."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from dofbench.core.errors import InputError
from dofbench.core.options import options


@options()
class Check:
    """Verify a dataset or results: digests, checksums, protocol, consistency, and scores computed again."""

    path: Annotated[Path, Positional]
    """Dataset folder, result folder, or a folder of results."""

    data: Path | None = None
    """The dataset's folder, to compute scores again, if it isn't where the results say. Without it: status 3."""


def check(settings: Check) -> int:
    """Print what is wrong; returns the exit status."""
    from dofbench.cli import app
    from dofbench.cli.check import Verdict
    from dofbench.cli.check import check as verdict_on

    statuses = {Verdict.GOOD: app.DONE, Verdict.NOT_RECOMPUTED: app.NOT_RECOMPUTED, Verdict.WRONG: app.FAILED}
    return statuses[verdict_on(settings.path, data=settings.data)]


@options()
class Score:
    """Score finished runs again, without training, from the stored predictions and model. New metrics are added in
    added.json. Scores of the result must come out the same."""

    results: Annotated[tuple[Path, ...], Positional] = (Path("results"),)
    """Results, or folders of results."""

    metrics: str | None = None
    """Columns, comma-separated: psnr for refocused views, aif_psnr for all-in-focus ones. Default: all there are."""

    data: Path | None = None
    """The dataset's folder, if it isn't where the results say."""

    lpips: Annotated[tuple[Path, ...] | None, arg(metavar="WEIGHTS [WEIGHTS]")] = None
    """LPIPS too, by these weights: torchvision's AlexNet or VGG16, and the linear layers of the lpips package (two
    files, or one with both). Without it, no LPIPS."""


def score(settings: Score) -> bool:
    """Score the results again; False where a score differs or a result couldn't be scored."""
    from dofbench.running.rescore import score as score_again

    return score_again(settings.results, settings.metrics, settings.data, lpips=settings.lpips)


@options()
class Scenes:
    """List the scenes that make-dataset can read: built-in ones, named datasets, and those in the folders given."""

    folders: Annotated[tuple[Path, ...], Positional] = ()
    """Folders that are scenes or hold scenes."""

    data_root: Path | None = None
    """Folder to look for named datasets in; without it, the one in DOFBENCH_DATA, if that is set."""


def scenes(settings: Scenes) -> bool:
    """Print the scenes; False where one can't be read."""
    from dofbench.scenes.listing import print_scenes

    return print_scenes(settings.folders, settings.data_root)


@options()
class Methods:
    """List the methods; or print one method's presets, options, devices and published figures."""

    method: Annotated[str | None, Positional] = None
    """Id of the method. Default: list all methods, one per line."""

    freeze: str | None = None
    """Fix this preset of the method: write the commit and a digest of its choices into the method's frozen.toml. Only
    fixed presets count on test scenes."""

    def __post_init__(self) -> None:
        if self.freeze is not None and self.method is None:
            raise InputError("--freeze", f"{self.freeze}, and no method", "the id of its method too")


def methods(settings: Methods) -> bool:
    """Print the methods, or fix a preset; False where a method can't be read."""
    if settings.method is not None and settings.freeze is not None:
        from dofbench.methods.cards import find_method
        from dofbench.methods.frozen_presets import FROZEN_FILE, freeze

        frozen = freeze(settings.method, settings.freeze)
        file = find_method(settings.method).folder / FROZEN_FILE
        preset = f"preset {settings.freeze} of {settings.method}"
        print(f"{preset} is fixed at commit {frozen.commit[:12]}, digest {frozen.digest[:16]}: {file}")
        return True
    from dofbench.cli.list_methods import print_methods

    return print_methods(settings.method)
