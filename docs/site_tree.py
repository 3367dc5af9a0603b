"""MkDocs hook: build the site from the repository's own layout, so that links work there and in a checkout alike.

MkDocs reads one folder that may not contain its configuration. So the folders with pages are linked into a temporary
folder, and report pages and notes, which come and go with the measurements, are added to the navigation.
"""

from __future__ import annotations

import re
import tempfile
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig

_ROOT = Path(__file__).resolve().parents[1]
_SHOWN = (
    *("README.md", "CHANGELOG.md", "CONTRIBUTING.md", "SECURITY.md", "LICENSE", "CITATION.cff"),
    *("docs", "reports", "examples", "benchmarks", "datasets/depthnet"),
)
_TREE = tempfile.TemporaryDirectory(prefix="dofbench-site-")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Read pages from the linked tree, and list those of reports/ and docs/notes/ by their headings."""
    tree = Path(_TREE.name)
    for name in _SHOWN:
        link = tree / name
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.exists():
            link.symlink_to(_ROOT / name)
    config.docs_dir = str(tree)
    assert config.nav is not None
    config.nav = [*config.nav, {"Reports": _pages("reports")}, {"Notes": _pages("docs/notes")}]
    return config


def _pages(folder: str) -> list[dict[str, str]]:
    pages = sorted((_ROOT / folder).rglob("*.md"), key=_place)
    return [{_title(page): page.relative_to(_ROOT).as_posix()} for page in pages]


def _place(page: Path) -> tuple[Path, bool, str]:
    return page.parent, page.name not in ("README.md", "index.md"), page.name


def _title(page: Path) -> str:
    heading = re.search(r"^# (.+)$", page.read_text(encoding="utf-8"), re.MULTILINE)
    return re.sub(r"[`*]", "", heading[1]) if heading else page.stem
