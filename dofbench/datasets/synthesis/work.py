"""Starting, resuming and finishing a dataset folder, so that a killed run loses only its last view.

Only files by names that make-dataset gives are ever removed, and none before the call is known to be right: the folder
may be a stranger's, or the user may keep other things in it.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from dofbench.core.checksums import checksums
from dofbench.core.errors import InputError
from dofbench.core.file_lock import FOLDER_LOCK
from dofbench.core.files import (
    TEMPORARY,
    canonical_json,
    drop_temporaries,
    read_json,
    refuse_links_outside,
    sha256_text,
    write_json,
)
from dofbench.core.names import inside
from dofbench.datasets.format import layout
from dofbench.datasets.format.schema import MANIFEST, read_manifest

WORK = ".work"
DEPTH_RECORD = "depth.json"
_STATE = "state.json"
_NOISE = "noise"
# What the stages keep in the work folder until the dataset is complete.
_KEPT = (DEPTH_RECORD, _NOISE, "depth", "network", "points", "reconstruction.npz")
# The fields of a view's record in lens.json that its photograph's files don't tell: the noise of a sampled lens.
NOISE = ("noise_rms_linear", "noise_psnr_db")
_OF_A_VIEW = (
    layout.sharp_path,
    layout.sharp_linear_path,
    layout.depth_path,
    layout.confidence_path,
    layout.linear_path,
    layout.shallow_path,
    layout.mask_path,
)


def noise_file(root: Path, view: str) -> Path:
    """Where the noise of a view's photograph is kept until lens.json is written."""
    return root / WORK / _NOISE / f"{inside(view, 'view')}.json"


@dataclass(frozen=True)
class Identity:
    """Everything that decides a dataset's content. rest: digest of everything except the images. images: sha256 by
    view.

    own_depth: whether the depth doesn't depend on the images.
    """

    rest: str
    images: Mapping[str, str]
    own_depth: bool

    @property
    def digest(self) -> str:
        """sha256 of everything."""
        return sha256_text(canonical_json({"rest": self.rest, "images": dict(self.images)}))


def prepare(root: Path, identity: Identity) -> Literal["complete", "open"]:
    """Prepare `root` for the dataset `identity`, keeping files that an earlier run of the same dataset finished.

    Returns "complete" if all files exist with the checksums in the manifest. In a finished dataset, damaged files of
    views are removed so that they are made again. In an unfinished dataset whose source images have changed, the files
    made from these images are removed. Raises InputError when the folder has other content.
    """
    refuse_links_outside(root)
    work = root / WORK
    if (root / MANIFEST).is_file():
        manifest = read_manifest(root)
        if manifest.identity != identity.digest:
            raise _holds_another(root)
        found = checksums(root, manifest.files)
        damaged = {name for name, record in manifest.files.items() if found[name] != record.sha256}
        # The previous run may have been killed between writing the manifest and tidying up.
        if not damaged:
            with suppress(InputError):  # a folder of the user's own is no concern of a complete dataset
                if _state(work) is not None:
                    finish(root)
            return "complete"
        if _state(work) is not None:
            finish(root)
        _begin(root, identity)
        # The depth's record is kept, so that complete depth needn't be made again for its record.
        if manifest.depth is not None:
            write_json(work / DEPTH_RECORD, manifest.depth.model_dump(mode="json"))
        _drop_damaged(root, identity, damaged)
        (root / MANIFEST).unlink()
        return "open"
    state = _state(work)
    if state is not None:
        if state["rest"] == identity.rest:
            drop_temporaries(root)
            _drop_outdated(root, identity, state["images"])
        elif any(path.is_file() and path != work / _STATE and not _unfinished(path, root) for path in root.rglob("*")):
            raise _holds_another(root)
        # Else the earlier run ended before it finished a file, and its input has been corrected since.
        _begin(root, identity)
        return "open"
    if root.is_dir() and any(entry.name not in (WORK, FOLDER_LOCK) for entry in root.iterdir()):
        raise InputError(root, "files that are no dataset", "an empty or a new folder")
    _begin(root, identity)
    return "open"


def finish(root: Path) -> None:
    """Remove the work folder; the last step."""
    work = root / WORK
    _drop_kept(work)
    drop_temporaries(work)
    # The state comes last: without it nobody would know whose folder this is.
    (work / _STATE).unlink(missing_ok=True)
    with suppress(OSError):  # the user keeps something in it
        work.rmdir()


def _state(work: Path) -> dict[str, Any] | None:
    """What an unfinished run noted in its work folder; None without one. Raises InputError for a folder of that name
    that no make-dataset made."""
    file = work / _STATE
    if not file.is_file():
        # A run may have been killed while it wrote its first file.
        if work.is_dir() and any(not entry.name.startswith(TEMPORARY) for entry in work.iterdir()):
            raise _not_ours(work)
        return None
    state = read_json(file)
    if not (isinstance(state, dict) and isinstance(state.get("rest"), str) and isinstance(state.get("images"), dict)):
        raise _not_ours(work)
    return state


def _not_ours(work: Path) -> InputError:
    return InputError(work, "a folder that make-dataset didn't make", "none of that name, or another --out")


def _begin(root: Path, identity: Identity) -> None:
    write_json(root / WORK / _STATE, {"rest": identity.rest, "images": dict(identity.images)})


def _unfinished(path: Path, root: Path) -> bool:
    parts = path.relative_to(root).parts
    return parts == (FOLDER_LOCK,) or any(part.startswith(TEMPORARY) for part in parts)


def _drop_outdated(root: Path, identity: Identity, before: Mapping[str, str]) -> None:
    """Remove files made from images that have changed; if depth is made from the images, remove all depth and
    photographs too."""
    changed = [view for view, digest in identity.images.items() if before.get(view) != digest]
    for view in changed:
        layout.sharp_path(root, view).unlink(missing_ok=True)
        layout.sharp_linear_path(root, view).unlink(missing_ok=True)
    if changed and not identity.own_depth:
        _drop_kept(root / WORK)
        for view in identity.images:
            layout.depth_path(root, view).unlink(missing_ok=True)
            layout.confidence_path(root, view).unlink(missing_ok=True)
        changed = list(identity.images)
    for view in changed:
        layout.mask_path(root, view).unlink(missing_ok=True)
        layout.linear_path(root, view).unlink(missing_ok=True)
        layout.shallow_path(root, view).unlink(missing_ok=True)


def _drop_kept(work: Path) -> None:
    for name in _KEPT:
        path = work / name
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)


def _holds_another(root: Path) -> InputError:
    return InputError(root, "another dataset", "the same one (scene, settings, version), or another --out")


def _drop_damaged(root: Path, identity: Identity, damaged: set[str]) -> None:
    """Remove the damaged files of views. All other files are written anew."""
    for view in identity.images:
        for place in _OF_A_VIEW:
            if layout.relative(place, view) in damaged:
                place(root, view).unlink(missing_ok=True)
