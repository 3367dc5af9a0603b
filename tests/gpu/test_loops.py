"""Loops of Triton kernels don't hand a value on to a name that began as its copy.

Before Triton compiles a loop, it goes through the body once to see which names get new values, and it tells a new value
by its identity. A name that starts as a copy of another (`before = grey`), and gets the other's value in the body
(`before, grey = grey, following`), has the identical value after that first pass. So it is taken for unchanged, and
keeps what it had before the loop: Triton 3.6 and 3.9 do so, while the interpreter runs the body as it stands.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

import dofbench.runtime.ops

KERNELS = Path(dofbench.runtime.ops.__path__[0])
MODULES = sorted(KERNELS.glob("*/gpu*.py"))


def names(target: ast.AST) -> set[str]:
    """The names that are given values by a part of a program."""
    return {node.id for node in ast.walk(target) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}


def copies(statement: ast.Assign) -> Iterator[tuple[str, str]]:
    """(name, what it becomes a copy of) for the names among an assignment's values."""
    for target in statement.targets:
        pairs = [(target, statement.value)]
        if isinstance(target, ast.Tuple) and isinstance(statement.value, ast.Tuple):
            pairs = list(zip(target.elts, statement.value.elts, strict=True))
        for left, right in pairs:
            if isinstance(left, ast.Name) and isinstance(right, ast.Name):
                yield left.id, right.id


def handed_on(loop: ast.For | ast.While, before: set[str]) -> list[str]:
    """Assignments in a loop's body that hand a value which the loop carries on to another name that it carries.

    before: the names that have a value before the loop."""
    carried, known, found = before & set().union(*map(names, loop.body)), set[str](), list[str]()
    for statement in (node for part in loop.body for node in ast.walk(part)):
        if isinstance(statement, ast.Assign):
            found += [f"{a} = {b}" for a, b in copies(statement) if a != b and {a, b} <= carried and b not in known]
            known |= names(statement)
        elif isinstance(statement, ast.For | ast.AugAssign):
            known |= names(statement.target)
    return found


def stored_before(function: ast.FunctionDef, line: int) -> set[str]:
    """The names that a function gives values above a line."""
    stores = (node for node in ast.walk(function) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))
    return {node.id for node in stores if node.lineno < line}


def loops(program: str) -> list[str]:
    """What all loops of a program's functions for a GPU hand on."""
    functions = [node for node in ast.walk(ast.parse(program)) if isinstance(node, ast.FunctionDef)]
    compiled = [one for one in functions if any("jit" in ast.unparse(decorator) for decorator in one.decorator_list)]
    return [
        f"{one.name}, line {loop.lineno}: {text}"
        for one in compiled
        for loop in ast.walk(one)
        if isinstance(loop, ast.For | ast.While)
        for text in handed_on(loop, stored_before(one, loop.lineno))
    ]


def test_there_are_kernels_to_read() -> None:
    assert {path.parent.name for path in MODULES} >= {"rasterize", "scatter", "stereo", "field"}


@pytest.mark.parametrize("module", MODULES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_no_loop_hands_a_carried_value_on(module: Path) -> None:
    assert loops(module.read_text(encoding="utf-8")) == []


@pytest.mark.parametrize(
    ("body", "count"),
    [
        ("before, value = value, tl.load(x + i)", 1),
        ("before = value\n        value = tl.load(x + i)", 1),
        ("value = tl.load(x + i)\n        before = value", 0),
        ("after = tl.load(x + i)\n        total += after - value\n        value = after", 0),
        ("other = value\n        value = tl.load(x + i) + other", 0),
        ("if i > 2:\n            before = value\n        value = tl.load(x + i)", 1),
    ],
)
def test_what_is_handed_on_is_found(body: str, count: int) -> None:
    above = "@triton.jit\ndef walk(x, n):\n    value = tl.load(x)\n    before = value\n    for i in range(n):\n"
    assert len(loops(f"{above}        {body}\n")) == count
