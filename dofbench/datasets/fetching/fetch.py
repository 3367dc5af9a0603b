"""Fetch the scenes of a named dataset: from its name to folders that `dofbench scenes` finds."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from dofbench.core.errors import InputError
from dofbench.core.file_lock import only_writer
from dofbench.core.progress import Progress, Terminal
from dofbench.datasets.fetching.download import RECORD, download, expected_checksum, record_download
from dofbench.datasets.fetching.failure import BadArchive, FetchFailure
from dofbench.datasets.fetching.fetch_options import Fetch
from dofbench.datasets.fetching.unpack import unpack
from dofbench.scenes.listing import inspect
from dofbench.scenes.named import (
    VARIABLE,
    Archive,
    NamedDataset,
    NamedScene,
    ResolvedScene,
    find_data_root,
    find_named,
    named_datasets,
    source_of,
    what_to_put,
)

DOWNLOADS = ".downloads"  # in the data root


@dataclass(frozen=True)
class _Wanted:
    """A scene that isn't here, the dataset and the scene with its files, and the archive that has it."""

    label: str
    source: NamedDataset
    original: NamedScene
    archive: Archive


def fetch(settings: Fetch, progress: Progress | None = None) -> bool:
    """Download and unpack what `settings.name` means and isn't here yet; prints what is here then.

    False when a download or an archive failed (what is complete stays), or a scene here isn't as the manifest says.
    Raises InputError for an unknown or ambiguous name, no data root, and a dataset that can't be downloaded by a
    program (with what to click and where to put it).
    """
    root = _data_root(settings.data_root)
    dataset, scenes = find_named(settings.name, root)
    if not scenes:
        raise _by_hand(dataset, settings.name, root)
    wanted = [_wanted(dataset, scene, settings.name, root) for scene in scenes if scene.missing]
    if not wanted:
        print(f"{settings.name}: here already, nothing to download")
    for source in {one.source.id: one.source for one in wanted}.values():
        print(f"{source.id}: {source.title}")
        print(f"licence: {source.licence}" + (f"; {source.terms}" if source.terms else ""))
    try:
        for url in dict.fromkeys(one.archive.url for one in wanted):
            of_archive = [one for one in wanted if one.archive.url == url]
            _fetch_archive(of_archive, root, settings.keep_archive, progress or Terminal())
    except FetchFailure as failure:
        print(f"dofbench: {failure}", file=sys.stderr)
        return False
    presences = [inspect(scene) for scene in find_named(settings.name, root)[1]]
    for presence in presences:
        print(f"{presence.scene.label}: {presence.state}, {presence.detail}, in {presence.scene.root}")
    here = "" if settings.data_root is None else f" --data-root {shlex.quote(str(settings.data_root))}"
    print(f"next: dofbench make-dataset {settings.name}{here}")
    return not any(presence.is_problem for presence in presences)


def _data_root(given: Path | None) -> Path:
    """The data root, made if it isn't there. Raises InputError where neither the option nor the variable names one."""
    text = os.environ.get(VARIABLE, "")
    root = given if given is not None else Path(text).expanduser() if text else None
    if root is None:
        raise InputError("--data-root", "nothing", f"the folder for named datasets; or set {VARIABLE}")
    if not root.exists():
        root.mkdir(parents=True)
    found = find_data_root(given)
    assert found is not None
    return found


def _wanted(dataset: NamedDataset, scene: ResolvedScene, asked: str, root: Path) -> _Wanted:
    """A scene that is missing. Raises InputError where no archive has it. asked: what the user typed."""
    name = scene.label.rpartition("/")[2]
    named = next(one for one in dataset.scenes if one.name == name)
    source, original = source_of(named_datasets(), dataset, named)
    for archive in source.archives:
        if not archive.scenes or original.name in archive.scenes:
            return _Wanted(scene.label, source, original, archive)
    raise _by_hand(source, asked, root, None if asked == source.id and source.folders else original)


def _by_hand(dataset: NamedDataset, asked: str, root: Path, scene: NamedScene | None = None) -> InputError:
    """The error for a dataset or a scene without an archive: where to put it, and what to click."""
    places = dataset.folders if scene is None else dataset.candidates(scene)
    put = what_to_put(dataset, places, root, None if scene is None else scene.made_by)
    if dataset.by_hand is None:
        return InputError(asked, "nothing to download", put)
    return InputError(asked, "no archive that a program can download", f"{put}. By hand: {dataset.by_hand}")


def _fetch_archive(wanted: Sequence[_Wanted], root: Path, keep_archive: bool, progress: Progress) -> None:
    """Download and unpack scenes of one archive."""
    archive = wanted[0].archive
    print(f"from {archive.url}")
    checksum = expected_checksum(archive, root)
    if checksum.sha256 is None:
        print(f"unverified: no checksum is published; the sha256 of this download goes into {root / RECORD}")
    elif not checksum.published:
        print(f"unverified: no checksum is published; compared with the first download's in {root / RECORD}")
    into = root if archive.into is None else root / archive.into
    scenes = {one.label: _places(archive, one) for one in wanted}
    folder = root / DOWNLOADS / wanted[0].source.id
    with only_writer(folder):
        file = download(archive, folder, checksum, progress)
        try:
            unpack(file, scenes, into, folder / "unpacking", progress)
        except BadArchive:
            file.unlink(missing_ok=True)  # else the next call would find it, and not download it again
            raise
        record_download(archive, file, checksum, root)
        if not keep_archive:
            shutil.rmtree(folder)
            with suppress(OSError):  # another dataset's download is in it
                folder.parent.rmdir()


def _places(archive: Archive, wanted: _Wanted) -> list[PurePosixPath]:
    """The folders that the scene may be in the archive: those of the manifest that are below `archive.into`."""
    into = PurePosixPath(archive.into or ".")
    places = map(PurePosixPath, wanted.source.candidates(wanted.original))
    return [place.relative_to(into) for place in places if place.is_relative_to(into)]
