"""One source file as symbols: what it defines on top, what each of these refers to, and what runs when it is imported.

Read without running anything. Docstrings, comments and what an error says aren't part of a symbol, so that words may
change; everything else is. Where names can't tell (a decorator that may register, a module chosen by an f-string) more
is counted in rather than less.
"""

from __future__ import annotations

import ast
import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

# Decorators that leave nothing behind but the function: all others may register it somewhere.
_LEAVE_NOTHING = {
    "cache",
    "cached",
    "cached_property",
    "contextmanager",
    "dataclass",
    "guvectorize",
    "intrinsic",
    "jit",
    "lru_cache",
    "njit",
    "runtime_checkable",
    "vectorize",
    "wraps",
}


_FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)


@dataclass(frozen=True)
class Reference:
    """What a symbol refers to: a local name and the dotted path behind it, as written: `name`, or `name.a.b`.

    called_with: "scatter" where it is called as `name("scatter", ...)`: the first argument, written out and fit to name
    a module; None for any other use.
    """

    path: tuple[str, ...]
    called_with: str | None = None


@dataclass
class Symbol:
    """A top-level definition. text: a digest of its code. references: what it names.

    loads: modules that it imports by a string; `*` stands for any part of such a name.
    """

    text: str
    references: frozenset[Reference]
    loads: frozenset[str]


@dataclass
class ModuleSymbols:
    """A file. imported: local name -> (module, attribute); the attribute is None where the module itself is meant.

    symbols: name -> definitions, several where a name is bound more than once. at_import: what runs at import and
    isn't a plain definition.
    """

    imported: dict[str, set[tuple[str, str | None]]] = field(default_factory=dict)
    symbols: dict[str, list[Symbol]] = field(default_factory=dict)
    at_import: list[Symbol] = field(default_factory=list)
    top_imports: set[tuple[str, str | None]] = field(default_factory=set)


def read_symbols(source: str, package: str) -> ModuleSymbols:
    """The symbols of a source text; package: the dotted package that its relative imports start from."""
    tree = ast.parse(source)
    found = ModuleSymbols()
    for node in ast.walk(tree):
        for local, target in _imports(node, package):
            found.imported.setdefault(local, set()).add(target)
    modules = {local for local, targets in found.imported.items() if local.islower() and _own(targets)}
    for statement in tree.body:
        if isinstance(statement, ast.Import | ast.ImportFrom):
            found.top_imports |= {target for _, target in _imports(statement, package)}
            continue
        if _is_docstring(statement) or _only_for_types(statement):
            continue
        bound = set(_bound(statement))
        if bound == {"__all__"}:
            continue
        symbol = _symbol(statement, modules)
        for name in bound:
            found.symbols.setdefault(name, []).append(symbol)
        if not bound or not _plain(statement):
            found.at_import.append(symbol)
    return found


def _imports(node: ast.AST, package: str) -> Iterator[tuple[str, tuple[str, str | None]]]:
    """(local name, (module, attribute)) of an import; nothing for any other node."""
    if isinstance(node, ast.Import):
        for alias in node.names:
            yield (
                (alias.asname, (alias.name, None))
                if alias.asname
                else (alias.name.split(".")[0], (alias.name.split(".")[0], None))
            )
    elif isinstance(node, ast.ImportFrom):
        base = node.module or ""
        if node.level:
            above = package.split(".")[: len(package.split(".")) - node.level + 1]
            base = ".".join([*above, base] if base else above)
        for alias in node.names:
            yield alias.asname or alias.name, (base, alias.name)


def _own(targets: set[tuple[str, str | None]]) -> bool:
    return all(module.partition(".")[0] in ("dofbench", "method") for module, _ in targets)


def _symbol(statement: ast.stmt, modules: set[str]) -> Symbol:
    cleaned = _Cleaner().visit(statement)
    references: set[Reference] = set()
    loads: set[str] = set()
    _collect(cleaned, references, loads)
    text = ast.dump(_Unnamed(modules).visit(cleaned), annotate_fields=False)
    return Symbol(hashlib.sha256(text.encode()).hexdigest(), frozenset(references), frozenset(loads))


def _collect(node: ast.AST, references: set[Reference], loads: set[str], local: frozenset[str] = frozenset()) -> None:
    """Add all names and dotted paths below a node but local variables, and the modules that its strings name."""
    if isinstance(node, ast.Name | ast.Attribute):
        path = _path(node)
        if path:
            stored = isinstance(node, ast.Name) and not isinstance(node.ctx, ast.Load)
            if path[0] not in local and not stored:
                references.add(Reference(path))
            return
    if isinstance(node, ast.Call) and _path(node.func)[-1:] == ("import_module",) and node.args:
        _load(node.args[0], loads)
    if isinstance(node, ast.Call) and (first := _first_word(node)) is not None:
        path = _path(node.func)
        if path[0] not in local:
            references.add(Reference(path, first))
        for child in (*node.args, *node.keywords):
            _collect(child, references, loads, local)
        return
    body = _body(node)
    inside = local | _local(node) if isinstance(node, _FUNCTIONS) else local
    for child in ast.iter_child_nodes(node):
        # Decorators, defaults and annotations are evaluated outside.
        _collect(child, references, loads, inside if any(child is one for one in body) else local)


def _first_word(call: ast.Call) -> str | None:
    """The first argument of a call of a name or a dotted path, where it is a string that may be a module's name."""
    if not call.args or not _path(call.func):
        return None
    match call.args[0]:
        case ast.Constant(value=str(word)) if word.isidentifier():
            return word
    return None


def _body(node: ast.AST) -> Sequence[ast.AST]:
    """What a function runs; nothing for any other node."""
    if isinstance(node, ast.Lambda):
        return [node.body]
    return node.body if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) else ()


def _load(name: ast.expr, loads: set[str]) -> None:
    """Add the module that an expression names, as far as it can be told: `f"dofbench.scenes.{layout}"`."""
    parts = name.values if isinstance(name, ast.JoinedStr) else [name]
    text = "".join(str(part.value) if isinstance(part, ast.Constant) else "*" for part in parts)
    if text.startswith("dofbench."):
        loads.add(text)


def _local(function: ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) -> set[str]:
    """Parameters and variables of a function."""
    names = {one.arg for one in ast.walk(function.args) if isinstance(one, ast.arg)}
    shared: set[str] = set()

    def look(node: ast.AST) -> None:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
        elif isinstance(node, ast.Global | ast.Nonlocal):
            shared.update(node.names)
        if not isinstance(node, _FUNCTIONS):
            for child in ast.iter_child_nodes(node):
                look(child)

    for one in _body(function):
        look(one)
    return names - shared


def _path(node: ast.AST) -> tuple[str, ...]:
    """("a", "b", "c") of `a.b.c`; () where it doesn't begin with a name."""
    parts: list[str] = []
    while isinstance(node, ast.Attribute):
        parts.append(node.attr)
        node = node.value
    return (node.id, *reversed(parts)) if isinstance(node, ast.Name) else ()


def _bound(statement: ast.stmt) -> Iterator[str]:
    """Names that a top-level statement binds."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield statement.name
        return
    for node in ast.walk(statement):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name


def _plain(statement: ast.stmt) -> bool:
    """Whether running the statement leaves nothing behind but the names that it binds."""
    if isinstance(statement, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        return all((_path(_called(one)) or ("?",))[-1] in _LEAVE_NOTHING for one in statement.decorator_list)
    return isinstance(statement, ast.Assign | ast.AnnAssign)


def _called(node: ast.expr) -> ast.expr:
    while isinstance(node, ast.Call):
        node = node.func
    return node


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


def _only_for_types(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.If) and _path(statement.test)[-1:] == ("TYPE_CHECKING",)


class _Cleaner(ast.NodeTransformer):
    """Takes out docstrings and imports, whose names are resolved elsewhere, and what a raised error is told."""

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.stmt:
        return self._without_docstring(node)

    def visit_AsyncFunctionDef(self, node: ast.AsyncFunctionDef) -> ast.stmt:
        return self._without_docstring(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.stmt:
        return self._without_docstring(node)

    def _without_docstring(self, node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> ast.stmt:
        self.generic_visit(node)
        node.body = [one for one in node.body if not _is_docstring(one)] or [ast.Pass()]
        return node

    def visit_Import(self, node: ast.Import) -> ast.stmt:
        return ast.Pass()

    def visit_ImportFrom(self, node: ast.ImportFrom) -> ast.stmt:
        return ast.Pass()

    def visit_Raise(self, node: ast.Raise) -> ast.stmt:
        if isinstance(node.exc, ast.Call):
            node.exc = node.exc.func
        return node


class _Unnamed(ast.NodeTransformer):
    """Takes out what a module of ours is called where something of it is used: `layout.RED` is any module's RED."""

    def __init__(self, modules: set[str]):
        self._modules = modules

    def visit_Attribute(self, node: ast.Attribute) -> ast.AST:
        self.generic_visit(node)
        if isinstance(node.value, ast.Name) and node.value.id in self._modules:
            node.value = ast.Name("", ast.Load())
        return node
