"""Options in groups: each group is a small frozen dataclass in the module that uses it, documented at the field.

Below every field is a docstring of this form, which `listed_options` parses:

    colour_lr: float = 1e-2
    \"\"\"Adam's learning rate of the colours at the start. Unit: 1 / step. Source: own.\"\"\"

The source is an equation or section of the paper, "released code" (of the paper's authors), another paper, or "own":
found by our own trainings. A method's options derive from `OptionGroups`. Option names are unique over all groups, so
`--set`, presets, `ablations.toml` and stored results name an option without its group.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any, Literal, Self, get_args, get_origin, get_type_hints

from dofbench.core.checksums import checksums
from dofbench.core.errors import InputError, unknown
from dofbench.core.files import canonical_json, files_below, sha256_text

_FORM = re.compile(r"(?P<meaning>.+?) Unit: (?P<unit>.+?)\. Source: (?P<source>.+)\.")
_TYPES = {bool: "true or false", int: "whole number", float: "number", str: "text"}


@dataclass(frozen=True)
class ListedOption:
    """The documentation of one option. group: the field of the method's options that holds it. type: in words, or the
    choices, comma-separated. default: the value without a preset. unit: "" without a unit."""

    name: str
    group: str
    type: str
    default: bool | int | float | str
    meaning: str
    unit: str
    source: str


@dataclass(frozen=True)
class OptionGroups:
    """Base of a method's options: a frozen dataclass whose fields are groups with defaults.

    Options that can't be combined raise InputError in `__post_init__` of a group or of the derived class.
    """

    @classmethod
    def of(cls, **values: Any) -> Self:
        """The defaults with some options replaced, given by name; raises the same errors as `with_overrides`."""
        return cls().with_overrides(values)

    def with_overrides(self, overrides: Mapping[str, Any], subject: str = "option") -> Self:
        """A copy with some options replaced; strings are converted to the option's type.

        subject: of error messages. Raises InputError for an unknown name, a value of another type, or one that can't be
        combined with the others.
        """
        places = _places(type(self))
        changes: dict[str, dict[str, Any]] = {}
        for name, value in overrides.items():
            if name not in places:
                raise unknown(subject, name, places)
            group, kind = places[name]
            changes.setdefault(group, {})[name] = _converted(f"{subject} {name}", value, kind)
        groups = {group: replace(getattr(self, group), **values) for group, values in changes.items()}
        return replace(self, **groups)

    def flat(self) -> dict[str, bool | int | float | str]:
        """Every option's value by its name."""
        return {name: getattr(getattr(self, group), name) for name, (group, _) in _places(type(self)).items()}

    def starts(self) -> list[float]:
        """Shares of the training at which something begins or ends, by the options' names; a step's cost may change."""
        values = [value for name, value in self.flat().items() if name.endswith(("_from", "_until", "_at"))]
        return sorted({value for value in values if isinstance(value, float) and 0 < value < 1})


def listed_options(options: type[OptionGroups]) -> tuple[ListedOption, ...]:
    """Every option of an options class, group by group, with its documentation from the source.

    Raises ValueError for a field without a docstring of the form above.
    """
    found, defaults = [], options().flat()
    texts = {field.name: _docstrings(type(getattr(options(), field.name))) for field in fields(options)}
    for name, (group, kind) in _places(options).items():
        form = _FORM.fullmatch(" ".join(texts[group].get(name, "").split()))
        if form is None:
            raise ValueError(f"option {name} of group {group}: expected 'MEANING Unit: UNIT. Source: SOURCE.' below it")
        unit = "" if form["unit"] == "none" else form["unit"]
        words = ", ".join(get_args(kind)) if get_origin(kind) is Literal else _TYPES[kind]
        found.append(ListedOption(name, group, words, defaults[name], form["meaning"], unit, form["source"]))
    return tuple(found)


def _found_places(options: type) -> dict[str, tuple[str, Any]]:
    """Option -> (group's field, type). Raises TypeError where two groups have an option of one name."""
    found: dict[str, tuple[str, Any]] = {}
    for group, kind in get_type_hints(options).items():
        for name, option in get_type_hints(kind).items():
            if name in found:
                raise TypeError(f"option {name}: in the groups {found[name][0]} and {group}, expected in one")
            found[name] = group, option
    return found


# Not cached by a decorator, because the type checker rejects a class as an argument of a function decorated so.
_places: Callable[[type], dict[str, tuple[str, Any]]] = cache(_found_places)


def _found_docstrings(group: type) -> dict[str, str]:
    """Field -> the docstring below it in the source of the group or its base."""
    parent = group.__mro__[1]
    found = {} if parent is object else dict(_docstrings(parent))
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(group))).body
    assert isinstance(definition, ast.ClassDef)
    for node, below in zip(definition.body, definition.body[1:], strict=False):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            text = below.value if isinstance(below, ast.Expr) else None
            if isinstance(text, ast.Constant) and isinstance(text.value, str):
                found[node.target.id] = text.value
    return found


_docstrings: Callable[[type], dict[str, str]] = cache(_found_docstrings)


def _converted(subject: str, value: Any, kind: Any) -> Any:
    if get_origin(kind) is Literal:
        if value not in get_args(kind):
            raise unknown(subject, str(value), get_args(kind))
        return value
    if kind is bool:
        words = {"true": True, "false": False, "1": True, "0": False}
        if isinstance(value, bool):
            return value
        if str(value).lower() not in words:
            raise InputError(subject, repr(value), "true or false")
        return words[str(value).lower()]
    try:
        converted = kind(value)
    except (TypeError, ValueError):
        raise InputError(subject, repr(value), f"a number ({kind.__name__})") from None
    if kind is int and float(value) != converted:
        raise InputError(subject, repr(value), "a whole number")
    return converted


CONTENT = {"content": True}  # metadata of an option that names a file or folder: its content decides a result
TORCHSCRIPT = "torchscript:"  # before the name of a TorchScript file, whose code runs with the user's rights


def content_digests(options: Any) -> dict[str, str]:
    """sha256 of the file or folder of each `CONTENT` option that names one, by option.

    options: a method's options, a dataclass of groups or of options. A network's side file, NAME.toml, counts as well.
    Raises InputError where there is neither a file nor a folder.
    """
    if not is_dataclass(options):
        return {}
    found: dict[str, str] = {}
    for field in fields(options):
        value = getattr(options, field.name)
        if field.metadata.get("content") and value:
            found[field.name] = _digest(field.name, Path(str(value).removeprefix(TORCHSCRIPT)))
        else:
            found |= content_digests(value)
    return found


def _digest(option: str, place: Path) -> str:
    if place.is_file():
        names = [place.name, *([f"{place.name}.toml"] if place.with_name(f"{place.name}.toml").is_file() else [])]
        # By order, not by name: a file that was renamed is the same one.
        known = checksums(place.parent, names)
        return sha256_text(canonical_json([known[name] for name in names]))
    if place.is_dir():
        files = [file.relative_to(place).as_posix() for file in files_below(place, "*")]
        return sha256_text(canonical_json(checksums(place, files)))
    raise InputError(f"option {option}", f"{place}, which isn't there", "a file or folder")
