"""Options whose value names a file or a folder: what is in it decides a result, and not where it is."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from dofbench.core.checksums import checksums
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, files_below, sha256_text

# Metadata of such an option's field.
CONTENT = {"content": True}
# Before the name of a TorchScript file: its code runs, with all rights of whoever calls.
TORCHSCRIPT = "torchscript:"


def content_digests(options: Any) -> dict[str, str]:
    """sha256 of what each such option names, by option; without options that name nothing.

    options: a method's options, a dataclass of groups or of options; of anything else there are none. A network's side
    file, NAME.toml, counts as well. Raises InputError where there is neither a file nor a folder.
    """
    if not is_dataclass(options):
        return {}
    found: dict[str, str] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if field.metadata.get("content") and value:
            found[field.name] = _digest(field.name, Path(str(value).removeprefix(TORCHSCRIPT)))
        else:
            found |= content_digests(value)
    return found


def _digest(option: str, place: Path) -> str:
    if place.is_file():
        names = [place.name, *([f"{place.name}.toml"] if place.with_name(f"{place.name}.toml").is_file() else [])]
        # By order, not by name: a file that was renamed is the same one.
        known = checksums(place.parent, names)
        return sha256_text(canonical_json([known[name] for name in names]))
    if place.is_dir():
        files = [file.relative_to(place).as_posix() for file in files_below(place, "*")]
        return sha256_text(canonical_json(checksums(place, files)))
    raise InputError(f"option {option}", f"{place}, which isn't there", "a file or folder")
