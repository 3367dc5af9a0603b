"""A report's HTML page as tests look at it: its tables, links, texts and embedded data."""

from __future__ import annotations

from dataclasses import dataclass, field
from html.parser import HTMLParser

VOID = {"meta", "link", "img", "input", "br", "hr"}


@dataclass
class Found:
    """A table of the page. groups: above the headings, with how many each spans. rows: texts and classes."""

    caption: str = ""
    groups: list[tuple[str, int]] = field(default_factory=list)
    headings: list[str] = field(default_factory=list)
    rows: list[list[tuple[str, str]]] = field(default_factory=list)

    @property
    def grouped(self) -> list[tuple[str, str]]:
        """(group, heading) of each column."""
        above = [group for group, count in self.groups for _ in range(count)] or [""] * len(self.headings)
        return list(zip(above, self.headings, strict=True))

    def cell(self, row: str, group: str, heading: str) -> str:
        """The text of a cell, by the text of the row's first cells joined by a space."""
        column = self.grouped.index((group, heading))
        (found,) = [cells for cells in self.rows if " ".join(text for text, _ in cells).startswith(row)]
        return found[column][0]


class Reader(HTMLParser):
    """Reads the page; raises AssertionError where an element isn't closed, or another one is."""

    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.addresses: list[str] = []
        self.tables: list[Found] = []
        self.data = ""
        self.texts: list[str] = []
        self._cell: list[str] | None = None
        self._kind = ""

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        found = dict(attributes)
        if tag not in VOID:
            self.open.append(tag)
        if "id" in found:
            self.ids.append(found["id"])
        if tag == "a":
            self.links.append(found["href"])
        self.addresses += [found[name] for name in ("src", "srcset", "action", "data", "poster") if found.get(name)]
        if tag == "link":
            self.addresses.append(found["href"])
        if tag == "table":
            self.tables.append(Found())
        if tag in ("th", "td", "caption"):
            self._cell, self._kind = [], found.get("class", "")
            if tag != "caption" and "colspan" in found:
                self._kind = f"span {found['colspan']}"
        if tag == "tr" and "tbody" in self.open:
            self.tables[-1].rows.append([])

    def handle_endtag(self, tag: str) -> None:
        assert self.open and self.open[-1] == tag, f"</{tag}> closes <{self.open[-1] if self.open else ''}>"
        self.open.pop()
        if tag not in ("th", "td", "caption") or not self.tables:
            return
        text, current = " ".join("".join(self._cell or []).split()), self.tables[-1]
        if tag == "caption":
            current.caption = text
        elif self._kind.startswith("span"):
            current.groups.append((text, int(self._kind.split()[1])))
        elif "thead" in self.open:
            current.headings.append(text)
        else:
            current.rows[-1].append((text, self._kind))
        self._cell = None

    def handle_data(self, text: str) -> None:
        inside = self.open[-1] if self.open else ""
        if inside == "script" and text.startswith("{"):
            self.data = text
        if inside not in ("script", "style"):
            self.texts.append(text)
        if self._cell is not None:
            self._cell.append(text)


def read(page: str) -> Reader:
    """The page, read to its end."""
    reader = Reader()
    reader.feed(page)
    reader.close()
    assert reader.open == []
    return reader
