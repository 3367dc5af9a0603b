"""Starting, resuming and finishing a dataset folder, so that a killed run loses only its last view."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, read_json, sha256_file, sha256_text, write_json
from dofbench.dataset import layout
from dofbench.dataset.schema import MANIFEST, Manifest, read_manifest

WORK = ".work"
DEPTH_RECORD = "depth.json"
_STATE = "state.json"
# The fields of a view's record in lens.json that its photograph's files don't tell: the noise of a sampled lens.
NOISE = ("noise_rms_linear", "noise_psnr_db")


def noise_file(root: Path, view: str) -> Path:
    """Where the noise of a view's photograph is kept until lens.json is written."""
    return root / WORK / "noise" / f"{view}.json"


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

    Returns "complete" if all files exist with the sizes in the manifest. In a finished dataset, damaged files are
    removed so that they are made again. In an unfinished dataset whose source images have changed, the files made from
    these images are removed. Raises InputError when the folder has other content.
    """
    work = root / WORK
    if (root / MANIFEST).is_file():
        manifest = read_manifest(root)
        if manifest.identity != identity.digest:
            raise _holds_another(root)
        # The previous run may have been killed between writing the manifest and tidying up.
        shutil.rmtree(work, ignore_errors=True)
        if all(
            (root / name).is_file() and (root / name).stat().st_size == record.size
            for name, record in manifest.files.items()
        ):
            return "complete"
        _begin(root, identity)
        # The depth's record is kept, so that complete depth needn't be made again for its record.
        if manifest.depth is not None:
            write_json(work / DEPTH_RECORD, manifest.depth.model_dump(mode="json"))
        _drop_damaged(root, manifest)
        (root / MANIFEST).unlink()
        return "open"
    if (work / _STATE).is_file():
        _drop_temporary_files(root)
        state = read_json(work / _STATE)
        if isinstance(state, dict) and state.get("rest") == identity.rest:
            _drop_outdated(root, identity, state["images"])
            _begin(root, identity)
            return "open"
        if [path for path in root.rglob("*") if path.is_file()] != [work / _STATE]:
            raise _holds_another(root)
        # The earlier run ended before it finished a file, and its input has been corrected since.
        _begin(root, identity)
        return "open"
    if root.is_dir() and any(entry.name != WORK for entry in root.iterdir()):
        raise InputError(root, "files that are no dataset", "an empty or a new folder")
    _begin(root, identity)
    return "open"


def finish(root: Path) -> None:
    """Remove the work folder; the last step."""
    shutil.rmtree(root / WORK)


def _begin(root: Path, identity: Identity) -> None:
    write_json(root / WORK / _STATE, {"rest": identity.rest, "images": dict(identity.images)})


def _drop_outdated(root: Path, identity: Identity, before: Mapping[str, str]) -> None:
    """Remove files made from images that have changed; if depth is made from the images, remove all depth and
    photographs too."""
    changed = [view for view, digest in identity.images.items() if before.get(view) != digest]
    for view in changed:
        layout.sharp_path(root, view).unlink(missing_ok=True)
    if changed and not identity.own_depth:
        for path in (root / WORK).iterdir():
            if path.is_dir():
                shutil.rmtree(path)
            elif path.name != _STATE:
                path.unlink()
        for view in identity.images:
            layout.depth_path(root, view).unlink(missing_ok=True)
            layout.confidence_path(root, view).unlink(missing_ok=True)
        changed = list(identity.images)
    for view in changed:
        layout.linear_path(root, view).unlink(missing_ok=True)
        layout.shallow_path(root, view).unlink(missing_ok=True)


def _holds_another(root: Path) -> InputError:
    return InputError(root, "another dataset", "the same one (scene, settings, version), or another --out")


def _drop_damaged(root: Path, manifest: Manifest) -> None:
    for name, record in manifest.files.items():
        path = root / name
        if path.is_file() and (path.stat().st_size != record.size or sha256_file(path) != record.sha256):
            path.unlink()


def _drop_temporary_files(root: Path) -> None:
    # A killed run leaves a hidden file or folder that it was writing; see files.replacing.
    for path in sorted(root.rglob(".*")):
        if path == root / WORK:
            continue
        if path.is_dir():
            shutil.rmtree(path)
        else:
            path.unlink(missing_ok=True)
