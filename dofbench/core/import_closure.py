"""What a function's outcome can depend on in this project's sources, as one digest.

The one answer to "was this made by the same code?", for results, stability, validation and compiled kernels. From the
entries named, names are followed from definition to definition, through imports, imports inside functions and modules
loaded by a string; what is reached is hashed. So a change outdates exactly what uses it: not what stands beside it in
its file, and not what only shows results. Files and folders may be renamed and code may move: only what it says counts,
without comments, docstrings and the texts of errors.

Of a call as `load("scatter")` that one kernel is counted in, with all its backends. Where the kernel's name isn't
written out in the call, every kernel is.

Other packages aren't followed: their versions stand in every result. Data files that decide something are handed over
by whoever reads them.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

from dofbench.core.content import content_folder
from dofbench.core.source_symbols import ModuleSymbols, Symbol, read_symbols

# Two references of one name are told apart by the code that they lead to, up to this many references away.
_DEPTH = 3
Entry = str | Callable[..., object]
Place = tuple[str, str]  # a module and a name in it; the name "" stands for what runs when the module is imported

# The package whose functions import `dofbench.kernels.<op>.<backend>` for the op that is their first argument.
_BRIDGE = "dofbench.kernels"
# The same package as it is reached by a call that writes the op's name out: it leads to no kernel, the call does.
_BRIDGE_TO_ONE = "dofbench.kernels, to one op"


class Sources:
    """Python sources by dotted module name.

    roots: dotted prefix -> folder; a longer prefix goes before a shorter one, and the prefix "" is a folder whose files
    are modules on top.
    """

    def __init__(self, roots: Mapping[str, Path]):
        self.roots = dict(roots)
        self._roots = sorted(roots.items(), key=lambda root: -len(root[0]))
        self._files: dict[str, Path | None] = {}

    def file(self, module: str) -> Path | None:
        """The module's file; None where it is no module of these sources."""
        if module not in self._files:
            self._files[module] = self._find(module)
        return self._files[module]

    def _find(self, module: str) -> Path | None:
        for prefix, folder in self._roots:
            if not prefix or module == prefix or module.startswith(prefix + "."):
                base = folder.joinpath(*module[len(prefix) :].strip(".").split("."))
                for file in (base / "__init__.py", *([base.with_suffix(".py")] if base != folder else [])):
                    if file.is_file():
                        return file
        return None

    def below(self, package: str) -> Iterator[str]:
        """All modules of a package, its own `__init__` too, and of a folder that is no package."""
        if self.file(package):
            yield package
        for prefix, folder in self._roots:
            if package == prefix or package.startswith(prefix + "."):
                top, name = folder.joinpath(*package[len(prefix) + 1 :].split(".")), package
            elif prefix.startswith(package + "."):
                top, name = folder, prefix
            else:
                continue
            for file in sorted(top.rglob("*.py")):
                parts = file.relative_to(top).with_suffix("").parts
                parts = parts[:-1] if parts[-1] == "__init__" else parts
                if parts:
                    yield ".".join([name, *parts])

    def matching(self, pattern: str) -> list[str]:
        """The modules whose name fits; `*` in the pattern stands for one part of a name."""
        if "*" not in pattern:
            return [pattern] if self.file(pattern) else []
        fits = re.compile(re.escape(pattern).replace(r"\*", "[^.]+"))
        return [module for module in self.below(pattern.partition("*")[0].rpartition(".")[0]) if fits.fullmatch(module)]

    def symbols(self, module: str) -> ModuleSymbols | None:
        """The module's symbols; None where it is no module of these sources."""
        if module == _BRIDGE_TO_ONE:
            known = self.symbols(_BRIDGE)
            return None if known is None else _without_loads(known)
        file = self.file(module)
        if file is None:
            return None
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        state = file.stat()
        return _read(file, package, state.st_mtime_ns, state.st_size)


@cache
def _read(file: Path, package: str, changed: int, size: int) -> ModuleSymbols:
    return read_symbols(file.read_text(encoding="utf-8"), package)


def _without_loads(known: ModuleSymbols) -> ModuleSymbols:
    """The same symbols, importing nothing by a string."""
    symbols = {name: [replace(one, loads=frozenset()) for one in found] for name, found in known.symbols.items()}
    return replace(known, symbols=symbols, at_import=[replace(one, loads=frozenset()) for one in known.at_import])


@cache
def own_sources() -> Sources:
    """The sources of dofbench and of its kernels."""
    package = Path(__file__).resolve().parent.parent
    return Sources({"dofbench": package, "dofbench.kernels": content_folder("kernels")})


def closure_digest(entries: Iterable[Entry], sources: Sources | None = None, data: Iterable[bytes] = ()) -> str:
    """sha256 over everything that the entries reach.

    entries: functions or classes; or "module:name" for one definition, "module" for all of a module, "package." for all
    modules below a package or a folder.
    data: contents of files that decide something too. Raises LookupError for an entry that isn't there.
    """
    reached = closure(entries, sources)
    digests = {place: {symbol.text for symbol, _ in found} for place, found in reached.items()}
    marks = {place: _hash(sorted(texts)) for place, texts in digests.items()}
    for _ in range(_DEPTH):
        marks = {
            place: _hash([marks[place], *sorted({f"{name} {marks[to]}" for _, leads in found for name, to in leads})])
            for place, found in reached.items()
        }
    return _hash([*sorted(set(marks.values())), *(hashlib.sha256(content).hexdigest() for content in data)])


def closure(
    entries: Iterable[Entry], sources: Sources | None = None
) -> dict[Place, list[tuple[Symbol, frozenset[tuple[str, Place]]]]]:
    """All places that the entries reach; each with its definitions, and by which name each leads to which places."""
    walk = _Walk(sources or own_sources())
    for entry in entries:
        if not isinstance(entry, str):
            entry = f"{entry.__module__}:{entry.__qualname__.partition('.')[0]}"  # of an inner one, the outer one
        module, _, name = entry.partition(":")
        places = list(walk.whole(module.rstrip("."), below=module.endswith("."))) if not name else [(module, name)]
        if not places or (name and not walk.defined((module, name))):
            raise LookupError(f"{entry} isn't among the sources")
        walk.queue += places
    return walk.run()


class _Walk:
    def __init__(self, sources: Sources):
        self._sources = sources
        self.queue: list[Place] = []

    def run(self) -> dict[Place, list[tuple[Symbol, frozenset[tuple[str, Place]]]]]:
        found: dict[Place, list[tuple[Symbol, frozenset[tuple[str, Place]]]]] = {}
        while self.queue:
            place = self.queue.pop()
            if place in found:
                continue
            module, name = place
            known = self._sources.symbols(module)
            assert known is not None
            found[place] = []
            for symbol in known.symbols.get(name, []) if name else known.at_import:
                leads = frozenset(self._leads(module, known, symbol))
                found[place].append((symbol, leads))
                self.queue += [to for _, to in leads]
            if name:
                self.queue.append((module, ""))
            else:  # importing a module imports its package and what it imports
                if self._sources.file(package := module.rpartition(".")[0]):
                    self.queue.append((package, ""))
                for target, attribute in known.top_imports:
                    self.queue += [(one, "") for one in self._loaded(target, attribute)]
        return found

    def _leads(self, module: str, known: ModuleSymbols, symbol: Symbol) -> Iterator[tuple[str, Place]]:
        """(last name of the path as written, place) of everything that a definition refers to."""
        for reference in symbol.references:
            first, *rest = reference.path
            written = reference.path[-1]
            if first in known.symbols:
                yield written, (module, first)
            for target, attribute in known.imported.get(first, ()):
                for place in self._resolved(target, [*filter(None, [attribute]), *rest]):
                    yield from ((written, one) for one in self._narrowed(place, reference.called_with))
        for name in symbol.loads:
            for one in self._sources.matching(name):
                yield from ((name, place) for place in self.whole(one))

    def _narrowed(self, place: Place, called_with: str | None) -> Iterator[Place]:
        """The place itself; of a call of the bridge that writes an op's name out, the bridge without its other ops."""
        module, name = place
        kernel = self._sources.matching(f"{_BRIDGE}.{called_with}.*") if module == _BRIDGE and called_with else []
        if not kernel:
            yield place
            return
        yield _BRIDGE_TO_ONE, name
        for one in kernel:
            yield from self.whole(one)

    def _resolved(self, module: str, path: list[str]) -> Iterator[Place]:
        """The places behind `module.path`: one definition, or a whole module where the module itself is used."""
        if self._sources.file(module) is None:
            if path and self._sources.file(f"{module}.{path[0]}"):  # a folder without __init__.py
                yield from self._resolved(f"{module}.{path[0]}", path[1:])
            return
        if not path:
            yield from self.whole(module)
            return
        known = self._sources.symbols(module)
        assert known is not None
        first, *rest = path
        if first in known.symbols:
            yield module, first
        elif self._sources.file(f"{module}.{first}"):
            yield from self._resolved(f"{module}.{first}", rest)
        elif first in known.imported:  # handed on by a package's __init__
            yield module, ""
            for target, attribute in known.imported[first] - {(module, first)}:
                yield from self._resolved(target, [*filter(None, [attribute]), *rest])
        elif "__getattr__" in known.symbols:  # loaded at first use
            yield module, "__getattr__"

    def _loaded(self, module: str, attribute: str | None) -> Iterator[str]:
        inside = f"{module}.{attribute}"
        if attribute and self._sources.file(inside):
            yield inside
        elif self._sources.file(module):
            yield module

    def defined(self, place: Place) -> bool:
        known = self._sources.symbols(place[0])
        return known is not None and place[1] in known.symbols

    def whole(self, module: str, below: bool = False) -> Iterator[Place]:
        """Everything that a module defines, and with `below` everything in the modules below it."""
        for one in self._sources.below(module) if below else [module]:
            known = self._sources.symbols(one)
            if known is not None:
                yield one, ""
                yield from ((one, name) for name in known.symbols)


def _hash(parts: Iterable[str]) -> str:
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
