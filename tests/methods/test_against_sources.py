"""docs/baselines.md: the tables that compare every method with its source have the values of its preset."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest

from dofbench.methods.cards import find_method

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "baselines.md"
OWN_PAGES = {"dofgaussian", "lensselect"}
COLUMNS = "| part | paper | public code | ours | effect |"
METHODS = sorted(card.parent.name for card in ROOT.glob("methods/*/method.toml") if card.parent.name not in OWN_PAGES)


def tables() -> dict[str, list[list[str]]]:
    """Heading -> the rows of its table, of the page's headings with such a table."""
    found: dict[str, list[list[str]]] = {}
    heading, inside = "", False
    for line in PAGE.read_text().splitlines():
        if line.startswith("#"):
            heading = line.lstrip("# ")
        inside = line.startswith("|") and (inside or line == COLUMNS)
        if inside and line != COLUMNS and not line.startswith("| ---"):
            found.setdefault(heading, []).append([cell.strip() for cell in line.strip("|").split("|")])
    return found


def stated(cell: str) -> dict[str, str]:
    return dict(re.findall(r"`(\w+)=([^`]+)`", cell))


def shared(method: str) -> list[list[str]]:
    """The rows that hold for all methods of the kind."""
    return tables()["Gaussians" if preset_of(method) == "short" else "Fields"]


def preset_of(method: str) -> str:
    return "short" if "short" in find_method(method).card.presets else "cpu"


def values(method: str) -> Any:
    entry = find_method(method)
    return entry.method_class().OPTIONS.of(**entry.preset(preset_of(method))[1])


@pytest.mark.parametrize("method", METHODS)
def test_our_column_has_the_preset_s_values(method: str) -> None:
    options = values(method)
    for part, _, _, ours, _ in [*shared(method), *tables()[method]]:
        for name, text in stated(ours).items():
            assert options.with_overrides({name: text}).flat()[name] == options.flat()[name], (part, name)


@pytest.mark.parametrize("method", METHODS)
def test_what_the_sources_have_are_values_of_options(method: str) -> None:
    """A row whose source has another value than we states ours beside it."""
    options = values(method)
    for part, paper, code, ours, _ in [*shared(method), *tables()[method]]:
        for cell in (paper, code):
            for name, text in stated(cell).items():
                theirs = options.with_overrides({name: text}).flat()[name]
                assert theirs == options.flat()[name] or name in stated(ours), (part, name)


@pytest.mark.parametrize("method", METHODS)
def test_every_option_that_a_card_sets_has_a_row(method: str) -> None:
    card = tomllib.loads((ROOT / "methods" / method / "method.toml").read_text())
    rows = [*shared(method), *tables()[method]]
    named = {name for row in rows for name in stated(row[3])}
    assert not set(card["presets"].get(preset_of(method), {})) - {"extends"} - named
