"""The public names of `dofbench`: fast to import, complete, and documented with shapes, units and errors."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from called import imported_by

import dofbench

SOURCE = Path(dofbench.__file__)
NAMES = [name for name in dofbench.__all__ if not name.startswith("_")]
# "(H, W, 3)", "(P,)", "(4, 4)": what a sentence about an array must say.
SHAPE = re.compile(r"\((?:[A-Z0-9]\w*, ?)+(?:[A-Z0-9]\w*)?(?:\[, C\])?\)")
UNIT = re.compile(
    r"pixels|px|scene units?|linear|encoded|\[0, 1\]|bool|disparity|metric|rigid|indices|confidence", re.IGNORECASE
)


def members(thing: Any) -> Iterator[tuple[str, Any, str]]:
    """(name, function, what is written about it) of a public thing: itself, or its public methods.

    What stands at a class holds for its methods too; so does what stands at a class for its fields.
    """
    if not inspect.isclass(thing):
        yield "", thing, inspect.getdoc(thing) or ""
        return
    for name, member in vars(thing).items():
        function = member.fget if isinstance(member, property) else getattr(member, "__func__", member)
        public = not name.startswith("_") or name == "__post_init__"  # what a class refuses, its docstring says
        if public and inspect.isfunction(function) and function.__module__.startswith("dofbench"):
            yield name, function, f"{inspect.getdoc(function) or ''}\n{inspect.getdoc(thing) or ''}"


EVERY = [
    pytest.param(function, text, id=f"{name}.{part}" if part else name)
    for name in NAMES
    for part, function, text in members(getattr(dofbench, name))
    if inspect.isfunction(function)
]


def test_import_is_light() -> None:
    loaded = imported_by("import dofbench")
    assert not {"numpy", "torch", "pydantic", "numba", "tyro"} & loaded
    assert {name for name in loaded if name.startswith("dofbench")} == {"dofbench"}


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = dofbench.nothing
    assert set(dofbench.__all__) <= set(dir(dofbench))


def test_type_checkers_read_the_same_list() -> None:
    """The imports that a checker alone sees, the places that __getattr__ looks in, and __all__ say one thing."""
    imported = {
        alias.asname: node.module.removeprefix("dofbench.")
        for branch in ast.parse(SOURCE.read_text()).body
        if isinstance(branch, ast.If)
        for node in branch.body
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("dofbench.")
        for alias in node.names
    }
    assert imported == dofbench._PLACES
    assert {*imported, "__version__"} == set(dofbench.__all__)
    assert len(set(dofbench.__all__)) == len(dofbench.__all__)


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_documented(name: str) -> None:
    thing = getattr(dofbench, name)
    if not (inspect.isclass(thing) or inspect.isfunction(thing)):
        return  # a table: its type's docstring says what it holds
    text = thing.__doc__ or ""
    assert text and not text.startswith(f"{name}("), "the docstring that dataclass makes up says nothing"
    for part, function, _ in members(thing):
        assert inspect.getdoc(function) or part == "__post_init__", f"{name}.{part}"


@pytest.mark.parametrize("name", NAMES)
def test_every_field_is_explained(name: str) -> None:
    """In the class's docstring by its name, or in a docstring behind it; one that says all by its name counts."""
    thing = getattr(dofbench, name)
    if not dataclasses.is_dataclass(thing):
        return
    explained: set[str] = set()
    for kind in thing.__mro__:
        if kind is object:
            continue
        (body,) = ast.parse(textwrap.dedent(inspect.getsource(kind))).body
        for one, following in zip(body.body, body.body[1:], strict=False):
            behind = isinstance(following, ast.Expr) and isinstance(following.value, ast.Constant)
            if isinstance(one, ast.AnnAssign) and behind:
                explained.add(one.target.id)
    text = thing.__doc__ or ""
    plain = {"name", "camera", "split", "id", "label", "folder", "manifest", "lenses", "points", "root"}
    missing = {
        field.name
        for field in dataclasses.fields(thing)
        if field.name not in explained | plain and not re.search(rf"\b{field.name}\b", text)
    }
    assert not missing


@pytest.mark.parametrize(("function", "text"), EVERY)
def test_arrays_have_shape_and_unit(function: Any, text: str) -> None:
    annotations = " ".join(str(value) for value in function.__annotations__.values())
    if "ndarray" in annotations or "Tensor" in annotations:
        assert SHAPE.search(text), "no shape"
        assert UNIT.search(text), "no unit"


@pytest.mark.parametrize("name", NAMES)
def test_fields_that_are_arrays_have_shape_and_unit(name: str) -> None:
    thing = getattr(dofbench, name)
    if dataclasses.is_dataclass(thing) and any("ndarray" in str(field.type) for field in dataclasses.fields(thing)):
        assert SHAPE.search(thing.__doc__) and UNIT.search(thing.__doc__)


@pytest.mark.parametrize(("function", "text"), EVERY)
def test_errors_are_said(function: Any, text: str) -> None:
    tree = ast.parse(textwrap.dedent(inspect.getsource(inspect.unwrap(function))))
    raised = {
        node.exc.func.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call) and isinstance(node.exc.func, ast.Name)
    }
    if function.__name__ == "__post_init__":  # of settings it is InputError for all; their docstrings are the help
        raised.discard("InputError")
    for error in raised:
        assert re.search(rf"\b{error}\b", text), f"{error} isn't said"


def test_the_rules_see_what_they_are_for() -> None:
    assert SHAPE.search("image: (H, W, 3) float32") and SHAPE.search("(P,) bool") and SHAPE.search("(4, 4) inverse")
    assert not SHAPE.search("an array (see below)") and not SHAPE.search("(the largest)")
