"""The public names of `dofbench`: fast to import, complete, documented."""

from __future__ import annotations

import inspect

import pytest
from called import imported_by

import dofbench

NAMES = [name for name in dofbench.__all__ if not name.startswith("_")]


def test_import_is_light() -> None:
    loaded = imported_by("import dofbench")
    assert not {"numpy", "torch", "pydantic", "numba", "tyro"} & loaded
    assert {name for name in loaded if name.startswith("dofbench")} == {"dofbench"}


def test_a_name_that_is_not_there_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="nothing"):
        _ = dofbench.nothing
    assert set(dofbench.__all__) <= set(dir(dofbench))


@pytest.mark.parametrize("name", NAMES)
def test_every_name_is_there_and_documented(name: str) -> None:
    thing = getattr(dofbench, name)
    if inspect.isclass(thing) or inspect.isfunction(thing):  # else a table: its type's docstring says what it holds
        assert thing.__doc__ and not thing.__doc__.startswith(f"{name}("), "dataclass made the docstring up"
