"""What a function's outcome can depend on in this project's sources, as one digest.

The one answer to "was this made by the same code?", for results, stability, validation and compiled kernels. From the
entries named, names are followed from definition to definition, through imports, imports inside functions and modules
loaded by a string; what is reached is hashed. So a change outdates exactly what uses it: not what stands beside it in
its file, and not what only shows results. Files and folders may be renamed and code may move: only what it says counts,
without comments, docstrings and the texts of errors.

Of a call as `load("scatter")` that one kernel is counted in, with all its backends that tensors of the device can get.
Where the kernel's name isn't written out in the call, every kernel is.

Other packages aren't followed: their versions stand in every result. Data files that decide something are handed over
by whoever reads them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable
from functools import cache
from pathlib import Path

from dofbench.core.content import content_folder
from dofbench.core.source_graph import Leads, Place, Sources, digest_of
from dofbench.core.source_symbols import Symbol

# Two references of one name are told apart by the code that they lead to, up to this many references away.
_DEPTH = 3
# The backends that no tensor on the CPU gets, and their parts (tests/kernels/test_registry.py holds the name to it).
_GPU_ALONE = re.compile(r"dofbench\.kernels\.[^.]+\.gpu(_\w+)?")
Entry = str | Callable[..., object]


@cache
def own_sources(device: str | None = None) -> Sources:
    """The sources of dofbench and of its kernels. device: "cpu" leaves out backends that only a GPU's tensors get, so
    that a change of them outdates nothing that was made on a CPU."""
    package = Path(__file__).resolve().parent.parent
    roots = {"dofbench": package, "dofbench.kernels": content_folder("kernels")}
    return Sources(roots, left_out=_GPU_ALONE if device == "cpu" else None)


def closure_digest(entries: Iterable[Entry], sources: Sources | None = None, data: Iterable[bytes] = ()) -> str:
    """sha256 over everything that the entries reach.

    entries: functions or classes; or "module:name" for one definition, "module" for all of a module, "package." for all
    modules below a package or a folder.
    data: contents of files that decide something too. Raises LookupError for an entry that isn't there.
    """
    sources = sources or own_sources()
    marks = {sources.mark(place, _DEPTH) for place in closure(entries, sources)}
    return digest_of([*sorted(marks), *(hashlib.sha256(content).hexdigest() for content in data)])


def closure(entries: Iterable[Entry], sources: Sources | None = None) -> dict[Place, list[tuple[Symbol, Leads]]]:
    """All places that the entries reach; each with its definitions, and by which name each leads to which places."""
    sources = sources or own_sources()
    sources.refresh()
    waiting: list[Place] = []
    for entry in entries:
        if not isinstance(entry, str):
            entry = f"{entry.__module__}:{entry.__qualname__.partition('.')[0]}"  # of an inner one, the outer one
        module, _, name = entry.partition(":")
        places = list(sources.whole(module.rstrip("."), below=module.endswith("."))) if not name else [(module, name)]
        if not places or (name and not sources.defined((module, name))):
            raise LookupError(f"{entry} isn't among the sources")
        waiting += places
    found: dict[Place, list[tuple[Symbol, Leads]]] = {}
    while waiting:
        place = waiting.pop()
        if place not in found:
            found[place] = sources.definitions(place)
            waiting += [to for _, leads in found[place] for _, to in leads]
            waiting += sources.imported_with(place)
    return found
