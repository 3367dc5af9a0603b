"""Unpack scenes of a zip archive, each whole or not at all."""

from __future__ import annotations

import shutil
import stat
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath, PureWindowsPath

from dofbench.core.progress import Progress
from dofbench.datasets.fetching.failure import BadArchive, FetchFailure


def unpack(
    archive: Path, scenes: Mapping[str, Sequence[PurePosixPath]], into: Path, work: Path, progress: Progress
) -> dict[str, Path]:
    """Unpack scenes into `into`; returns the folder of each.

    scenes: by label, the folders that a scene may be in the archive; the first one that is there counts. work: a folder
    on the same disk that no reader looks into. A scene is unpacked there and moves to its place when it is complete.

    Raises BadArchive, with nothing unpacked, for a file that is no zip archive, a member that leads out of the folder
    or is a link, and a scene that isn't in the archive; FetchFailure for a place that is taken, or too little space.
    """
    try:
        with zipfile.ZipFile(archive) as opened:
            members = [(_inside(archive, info), info) for info in opened.infolist()]
            found = {label: _first(archive, label, folders, members) for label, folders in scenes.items()}
            for folder in found.values():
                if (into / folder).exists():
                    raise FetchFailure(f"{into / folder}: there already; move it away to fetch it again")
            wanted = [(path, info) for path, info in members if any(_below(path, folder) for folder in found.values())]
            _check_space(work, sum(info.file_size for _, info in wanted))
            done = 0
            for folder in found.values():
                shutil.rmtree(work, ignore_errors=True)  # what a killed call left
                for path, info in wanted:
                    if _below(path, folder):
                        _write(opened, info, work / path)
                        done += 1
                        progress.update("unpack (files)", done, len(wanted))
                (into / folder).parent.mkdir(parents=True, exist_ok=True)
                (work / folder).rename(into / folder)
    except zipfile.BadZipFile as error:
        raise BadArchive(f"{archive.name}: not a whole zip archive ({error})") from None
    finally:
        progress.close()
        shutil.rmtree(work, ignore_errors=True)
    return {label: into / folder for label, folder in found.items()}


def _inside(archive: Path, info: zipfile.ZipInfo) -> PurePosixPath:
    """The member's path. Raises BadArchive where it leads out of the folder, on any system, or is a link."""
    path, windows = PurePosixPath(info.filename), PureWindowsPath(info.filename)
    if path.is_absolute() or windows.drive or windows.root or ".." in (*path.parts, *windows.parts):
        raise BadArchive(f"{archive.name}: member {info.filename!r} leads out of its folder; nothing was unpacked")
    if stat.S_ISLNK(info.external_attr >> 16):
        raise BadArchive(f"{archive.name}: member {info.filename!r} is a link; nothing was unpacked")
    return path


def _first(
    archive: Path,
    label: str,
    folders: Sequence[PurePosixPath],
    members: Sequence[tuple[PurePosixPath, zipfile.ZipInfo]],
) -> PurePosixPath:
    for folder in folders:
        if any(_below(path, folder) and not info.is_dir() for path, info in members):
            return folder
    listed = ", ".join(map(str, folders))
    raise BadArchive(f"{archive.name}: no {label} in it, expected {listed}; nothing was unpacked")


def _below(path: PurePosixPath, folder: PurePosixPath) -> bool:
    return path.parts[: len(folder.parts)] == folder.parts and path != folder


def _check_space(work: Path, needed: int) -> None:
    free = shutil.disk_usage(work.parent).free
    if needed > free:
        raise FetchFailure(f"{work.parent}: {free / 1e9:.1f} GB free, unpacking needs {needed / 1e9:.1f} GB")


def _write(opened: zipfile.ZipFile, info: zipfile.ZipInfo, target: Path) -> None:
    if info.is_dir():
        target.mkdir(parents=True, exist_ok=True)
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    with opened.open(info) as source, target.open("wb") as stream:
        shutil.copyfileobj(source, stream, 1 << 20)
