"""The imports of dofbench as they stand in its sources: which module imports which, functions' own imports included."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

CONTENT = ("kernels", "methods")  # content folders, each reached through the package of the same name


def modules(root: Path) -> dict[str, Path]:
    """Dotted name below `dofbench` -> file, content folders included, a package by its own name."""
    found = {}
    for folder in (root / "dofbench", *(root / name for name in CONTENT)):
        for file in folder.rglob("*.py"):
            parts = file.relative_to(root).with_suffix("").parts
            parts = parts[1:] if parts[0] == "dofbench" else parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" and len(parts) > 1 else parts)] = file
    return found


def arrows(known: dict[str, Path], *, checked_only: bool = False) -> Iterator[tuple[str, str]]:
    """(module, module that it imports), imports inside functions included.

    checked_only: without those that a type checker alone sees.
    """
    for name, file in known.items():
        tree = ast.parse(file.read_text())
        unseen = {
            id(inner)
            for node in ast.walk(tree)
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
            for inner in ast.walk(node)
        }
        package = name.split(".") if file.name == "__init__.py" else name.split(".")[:-1]
        for node in ast.walk(tree):
            if checked_only and id(node) in unseen:
                continue
            if isinstance(node, ast.ImportFrom):
                if node.level:
                    start = package[: len(package) - node.level + 1]
                elif (node.module or "").split(".")[0] == "dofbench":
                    start = []
                else:
                    continue
                rest = (node.module or "").split(".") if node.module else []
                base = [*start, *(rest if node.level else rest[1:])]
                for alias in node.names:
                    whole = ".".join([*base, alias.name])
                    target = whole if whole in known else ".".join(base)
                    if target != name:
                        yield name, target
            elif isinstance(node, ast.Import):
                for alias in node.names:
                    if alias.name.startswith("dofbench."):
                        yield name, alias.name.removeprefix("dofbench.")


def package_of(module: str) -> str:
    """The package in the order that a module belongs to; "" for `dofbench` itself."""
    first = module.split(".")[0]
    return "" if first in ("__init__", "__main__") else first
