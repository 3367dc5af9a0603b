"""Facts of training sets, kept in the user's cache: to look at hundreds of photographs takes longer than the rest of a
plan, and every command plans anew."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict

from dofbench.core.checksums import cache_folder
from dofbench.core.errors import InputError
from dofbench.core.files import canonical_json, read_json, sha256_text, write_json
from dofbench.core.source_digest import package_digest
from dofbench.methods.stages.facts import Facts


def kept_facts(checksum: str, inputs: str, held_out: float, look: Callable[[], Facts]) -> Facts:
    """The facts of a dataset's training set as they were found before by the same code; else `look` finds them.

    checksum: of the dataset. inputs, held_out: what of it a method receives. A cache that is damaged, or can't be
    written, is as good as an empty one.
    """
    folder = cache_folder()
    if folder is None:
        return look()
    key = sha256_text(canonical_json([checksum, inputs, held_out, package_digest()]))
    file = folder / "facts" / f"{key[:32]}.json"
    with suppress(InputError, TypeError):
        return Facts(**read_json(file))
    found = look()
    with suppress(OSError):
        write_json(file, asdict(found))
    return found
