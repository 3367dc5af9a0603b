"""Tolerances are written in one file: no other file of the suite compares within a number of its own, and every
tolerance is used."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
TABLE = TESTS / "tolerances.py"
FILES = sorted(path for path in TESTS.rglob("*.py") if path != TABLE)

NAMES = {"abs", "rel", "atol", "rtol", "places", "delta"}
# A comparison with so small a number is one of a difference with zero.
SMALL = 1e-3


def own_tolerances(source: str) -> list[tuple[int, str]]:
    """(line, text) of every tolerance that a source writes itself: an argument named abs, rel, atol or rtol that isn't
    zero and names no tolerance of the table, and a comparison with a small number."""
    tree = ast.parse(source)
    table = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module == "tolerances"
        for alias in node.names
    }
    # A name that is made from a tolerance of the table stands for one.
    for node in ast.walk(tree):
        if isinstance(node, ast.Assign) and _names(node.value) & table:
            table |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            for word in node.keywords:
                if word.arg in NAMES and not _names(word.value) & table and _numbers(word.value):
                    found.append((word.value.lineno, ast.unparse(word.value)))
        elif isinstance(node, ast.Compare):
            sides = (node.left, *node.comparators)
            for less, op, more in zip(sides, node.ops, sides[1:], strict=False):
                if isinstance(op, ast.Gt | ast.GtE):
                    less, more = more, less
                elif not isinstance(op, ast.Lt | ast.LtE):
                    continue
                # At most a small number, or at least a small negative one.
                for side, sign in ((more, 1), (less, -1)):
                    if any(0 < sign * number <= SMALL for number in _numbers(side)) and not _names(side) & table:
                        found.append((side.lineno, ast.unparse(node)))
    return found


def _names(node: ast.AST) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)}


def _numbers(node: ast.AST) -> list[float]:
    """The numbers but zero in an expression, without those that are arguments of a call within it."""
    if isinstance(node, ast.Constant):
        return [node.value] if isinstance(node.value, int | float) and node.value else []
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
        return [-number for number in _numbers(node.operand)]
    if isinstance(node, ast.UnaryOp | ast.BinOp):
        return [number for part in ast.iter_child_nodes(node) for number in _numbers(part)]
    return []


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(TESTS).as_posix())
def test_no_test_has_a_tolerance_of_its_own(path: Path) -> None:
    assert own_tolerances(path.read_text()) == []


@pytest.mark.parametrize(
    ("source", "count"),
    [
        ("assert a == approx(b, abs=1e-3)", 1),
        ("assert a == approx(b, rel=2 * 0.01)", 1),
        ("assert_allclose(a, b, rtol=0, atol=3)", 1),
        ("assert a == approx(b, abs=2.0 ** (2 - len(a)))", 1),
        ("assert (a - b).max() < 1e-5", 1),
        ("assert -1e-9 < a - b", 1),
        ("assert 1 + 1e-6 > a", 1),
        ("assert 0 <= a <= 1e-6", 1),
        ("from tolerances import X\nassert a == approx(b, abs=2 * X)", 0),
        ("from tolerances import X\nslack = X * size\nassert a == approx(b, abs=slack)", 0),
        ("assert_allclose(a, b, rtol=0, atol=0)", 0),
        ("assert a < 0.25 and b > 3 and (a - b).max() > 1e-3", 0),
        ("scene(1e-6) == 4", 0),
    ],
)
def test_what_counts_as_a_tolerance_of_its_own(source: str, count: int) -> None:
    assert len(own_tolerances(source)) == count


def test_every_tolerance_is_used_and_has_a_reason() -> None:
    used = set()
    for path in FILES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "tolerances":
                used |= {alias.name for alias in node.names}
    lines = TABLE.read_text().splitlines()
    for node in ast.parse(TABLE.read_text()).body:
        if isinstance(node, ast.Assign):
            (target,) = node.targets
            names = {part.id for part in ast.walk(target) if isinstance(part, ast.Name)}
            assert names <= used, f"{sorted(names - used)}: no test uses it"
            block = lines[node.lineno - 2]
            assert block.startswith("#") or "#" in lines[node.lineno - 1] or "=" in block, f"{names}: no reason"


def test_no_reason_is_a_tolerance_s_own_measurement() -> None:
    assert "measured" not in TABLE.read_text().lower().replace("measured_noise", "")
