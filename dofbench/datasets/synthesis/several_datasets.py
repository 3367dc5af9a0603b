"""The datasets of one command, scenes x lenses: each is made in a process of its own, several at a time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.core.jobs import Executor, Job, Outcome, Report
from dofbench.core.progress import Reported, Several
from dofbench.datasets.synthesis.builder import BUILT_IN, default_folder, make
from dofbench.datasets.synthesis.dataset_options import MakeDataset, MakeDatasets
from dofbench.scenes.named import ResolvedScene, find_data_root, resolve


def planned(settings: MakeDatasets) -> tuple[list[MakeDataset], list[ResolvedScene]]:
    """One dataset's settings for each scene and each lens of `--assign fixed`, and the scenes that are missing.

    Raises InputError for an unknown scene, and for two datasets that would go into one folder.
    """
    root = find_data_root(settings.data_root)
    scenes, missing = [], []
    for text in settings.scenes or (BUILT_IN,):
        for scene in resolve(text, root):
            if scene.missing:
                missing.append(scene)
            else:
                # A folder is kept as its path, because its label wouldn't be found again.
                scenes.append((text if Path(text).is_dir() else scene.label, scene.name))
    lenses = settings.lenses()
    if len(scenes) * len(lenses) == 1:
        ((text, name),) = scenes
        return [settings.one(text, settings.out or default_folder(name), lenses[0])], missing
    if settings.reuse is not None:
        raise InputError("--reuse", f"{len(scenes) * len(lenses)} datasets to make", "one")
    parent = settings.out or default_folder("")
    datasets = [
        settings.one(text, parent / (f"{name}-{lens[0]}" if lens and len(lenses) > 1 else name), lens)
        for text, name in scenes
        for lens in lenses
    ]
    folder, times = Counter(dataset.out for dataset in datasets).most_common(1)[0]
    if times > 1:
        raise InputError(str(folder), f"{times} scenes that would go there", "scenes of different names")
    return datasets, missing


def make_all(datasets: Sequence[MakeDataset], executor: Executor) -> list[Outcome]:
    """Make the datasets by an executor. One that fails doesn't stop the others.

    For a scene with several lenses, the first dataset is made before the others, which copy its sharp images and depth.
    """
    first: dict[str | None, Path] = {}
    jobs = []
    for dataset in datasets:
        assert dataset.out is not None
        sibling = first.setdefault(dataset.scene, dataset.out)
        alone = sibling == dataset.out
        jobs.append(
            Job(
                str(dataset.out),
                partial(_make_one, dataset, None if alone else sibling),
                after=None if alone else str(sibling),
            )
        )
    return executor.run(jobs, Several(len(jobs), min(executor.at_a_time, len(jobs))))


def _make_one(settings: MakeDataset, sibling: Path | None, report: Report) -> str:
    progress = Reported(report)
    make(settings, progress, sibling=sibling)
    return progress.message
