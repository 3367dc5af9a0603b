"""Which sources there are, and what each definition in them leads to; read once, and again where a file has changed."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path

from dofbench.core.source_symbols import ModuleSymbols, Symbol, read_symbols

Place = tuple[str, str]  # a module and a name in it; the name "" stands for what runs when the module is imported
Leads = frozenset[tuple[str, Place]]  # by which name (the last of the path as written) a definition leads where

# The package whose functions import `dofbench.kernels.<op>.<backend>` for the op that is their first argument.
_BRIDGE = "dofbench.kernels"
# The same package as it is reached by a call that writes the op's name out: it leads to no kernel, the call does.
_BRIDGE_TO_ONE = "dofbench.kernels, to one op"


class Sources:
    """Python sources by dotted module name.

    roots: dotted prefix -> folder; a longer prefix goes before a shorter one, and the prefix "" is a folder whose files
    are modules on top. beside: sources that go before these ones and lead to nothing in these. left_out: modules that
    count as if they weren't there, by their whole names.
    """

    def __init__(
        self, roots: Mapping[str, Path], beside: Sources | None = None, left_out: re.Pattern[str] | None = None
    ):
        self.roots: dict[str, Path] = {**(beside.roots if beside is not None else {}), **roots}
        self._beside = beside
        self._left_out = left_out
        self._roots = sorted(roots.items(), key=lambda root: -len(root[0]))
        self._files: dict[str, Path | None] = {}
        self._forget()

    def _forget(self) -> None:
        self._states: dict[Path, tuple[int, int]] = {}
        self._symbols: dict[str, ModuleSymbols | None] = {}
        self._matching: dict[str, list[str]] = {}
        self._definitions: dict[Place, list[tuple[Symbol, Leads]]] = {}
        self._marks: dict[tuple[Place, int], str] = {}

    def refresh(self) -> None:
        """Forget what was read where a file has changed since, or a module that is loaded by a string came or went."""
        if self._beside is not None:
            self._beside.refresh()
        same = all(_state(file) == state for file, state in self._states.items())
        if not same or any(self._match(pattern) != found for pattern, found in self._matching.items()):
            self._forget()

    def file(self, module: str) -> Path | None:
        """The module's file; None where it is no module of these sources."""
        if module not in self._files:
            beside = self._beside.file(module) if self._beside is not None else None
            self._files[module] = None if self._without(module) else beside or self._find(module)
        return self._files[module]

    def _without(self, module: str) -> bool:
        if self._left_out is not None and self._left_out.fullmatch(module):
            return True
        return self._beside is not None and self._beside._without(module)

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
        for prefix, folder in sorted(self.roots.items(), key=lambda root: -len(root[0])):
            if package == prefix or package.startswith(prefix + "."):
                top, name = folder.joinpath(*package[len(prefix) + 1 :].split(".")), package
            elif prefix.startswith(package + "."):
                top, name = folder, prefix
            else:
                continue
            for file in sorted(top.rglob("*.py")):
                parts = file.relative_to(top).with_suffix("").parts
                parts = parts[:-1] if parts[-1] == "__init__" else parts
                module = ".".join([name, *parts])
                if parts and not self._without(module):
                    yield module

    def matching(self, pattern: str) -> list[str]:
        """The modules whose name fits; `*` in the pattern stands for one part of a name."""
        if pattern not in self._matching:
            self._matching[pattern] = self._match(pattern)
        return self._matching[pattern]

    def _match(self, pattern: str) -> list[str]:
        if "*" not in pattern:
            return [pattern] if self.file(pattern) else []
        fits = re.compile(re.escape(pattern).replace(r"\*", "[^.]+"))
        return [module for module in self.below(pattern.partition("*")[0].rpartition(".")[0]) if fits.fullmatch(module)]

    def symbols(self, module: str) -> ModuleSymbols | None:
        """The module's symbols; None where it is no module of these sources."""
        if module not in self._symbols:
            self._symbols[module] = self._read(module)
        return self._symbols[module]

    def _read(self, module: str) -> ModuleSymbols | None:
        if module == _BRIDGE_TO_ONE:
            known = self.symbols(_BRIDGE)
            return None if known is None else _without_loads(known)
        file = self.file(module)
        if file is None:
            return None
        package = module if file.name == "__init__.py" else module.rpartition(".")[0]
        state = self._states[file] = _state(file)
        return _read(file, package, state)

    def whole(self, module: str, below: bool = False) -> Iterator[Place]:
        """Everything that a module defines, and with `below` everything in the modules below it."""
        for one in self.below(module) if below else [module]:
            known = self.symbols(one)
            if known is not None:
                yield one, ""
                yield from ((one, name) for name in known.symbols)

    def defined(self, place: Place) -> bool:
        """Whether the module has a definition of that name."""
        known = self.symbols(place[0])
        return known is not None and place[1] in known.symbols

    def definitions(self, place: Place) -> list[tuple[Symbol, Leads]]:
        """The definitions of a name, several where it is bound more than once, each with what it leads to."""
        if self._beside is not None and self._beside.symbols(place[0]) is not None:
            return self._beside.definitions(place)
        if place not in self._definitions:
            module, name = place
            known = self.symbols(module)
            assert known is not None
            symbols = known.symbols.get(name, []) if name else known.at_import
            self._definitions[place] = [(symbol, frozenset(self._leads(module, known, symbol))) for symbol in symbols]
        return self._definitions[place]

    def imported_with(self, place: Place) -> Iterator[Place]:
        """What runs too where a definition is used: its module's import, and with it the module's own imports."""
        module, name = place
        if name:
            yield module, ""
            return
        if self.file(package := module.rpartition(".")[0]):
            yield package, ""
        known = self.symbols(module)
        assert known is not None
        for target, attribute in known.top_imports:
            yield from ((one, "") for one in self._loaded(target, attribute))

    def mark(self, place: Place, depth: int) -> str:
        """A digest of a place's definitions, and of those that they lead to, so many references away."""
        if self._beside is not None and self._beside.symbols(place[0]) is not None:
            return self._beside.mark(place, depth)
        if (place, depth) not in self._marks:
            found = self.definitions(place)
            if depth == 0:
                parts = sorted({symbol.text for symbol, _ in found})
            else:
                leads = {f"{name} {self.mark(to, depth - 1)}" for _, leads in found for name, to in leads}
                parts = [self.mark(place, depth - 1), *sorted(leads)]
            self._marks[place, depth] = digest_of(parts)
        return self._marks[place, depth]

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
            for one in self.matching(name):
                yield from ((name, place) for place in self.whole(one))

    def _narrowed(self, place: Place, called_with: str | None) -> Iterator[Place]:
        """The place itself; of a call of the bridge that writes an op's name out, the bridge without its other ops."""
        module, name = place
        kernel = self.matching(f"{_BRIDGE}.{called_with}.*") if module == _BRIDGE and called_with else []
        if not kernel:
            yield place
            return
        yield _BRIDGE_TO_ONE, name
        for one in kernel:
            yield from self.whole(one)

    def _resolved(self, module: str, path: list[str]) -> Iterator[Place]:
        """The places behind `module.path`: one definition, or a whole module where the module itself is used."""
        if self.file(module) is None:
            if path and self.file(f"{module}.{path[0]}"):  # a folder without __init__.py
                yield from self._resolved(f"{module}.{path[0]}", path[1:])
            return
        if not path:
            yield from self.whole(module)
            return
        known = self.symbols(module)
        assert known is not None
        first, *rest = path
        if first in known.symbols:
            yield module, first
        elif self.file(f"{module}.{first}"):
            yield from self._resolved(f"{module}.{first}", rest)
        elif first in known.imported:  # handed on by a package's __init__
            yield module, ""
            for target, attribute in known.imported[first] - {(module, first)}:
                yield from self._resolved(target, [*filter(None, [attribute]), *rest])
        elif "__getattr__" in known.symbols:  # loaded at first use
            yield module, "__getattr__"

    def _loaded(self, module: str, attribute: str | None) -> Iterator[str]:
        inside = f"{module}.{attribute}"
        if attribute and self.file(inside):
            yield inside
        elif self.file(module):
            yield module


@cache
def _read(file: Path, package: str, state: tuple[int, int]) -> ModuleSymbols:
    return read_symbols(file.read_text(encoding="utf-8"), package)


def _state(file: Path) -> tuple[int, int]:
    """What tells that a file has changed: when, and its size; of a file that went, nothing that a file has."""
    try:
        found = file.stat()
    except FileNotFoundError:
        return -1, -1
    return found.st_mtime_ns, found.st_size


def _without_loads(known: ModuleSymbols) -> ModuleSymbols:
    """The same symbols, importing nothing by a string."""
    symbols = {name: [replace(one, loads=frozenset()) for one in found] for name, found in known.symbols.items()}
    return replace(known, symbols=symbols, at_import=[replace(one, loads=frozenset()) for one in known.at_import])


def digest_of(parts: Iterable[str]) -> str:
    """sha256 over these texts."""
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()
