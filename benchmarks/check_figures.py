"""Compare every figure that README.md, reports/ and docs/ state with the CSV that it is tied to, and check where the
figures come from: the commit is in the history, the command can be called, the machine is named.

    python benchmarks/check_figures.py              # all pages; exit status 1 if a figure is wrong
    python benchmarks/check_figures.py reports/lens # those below a folder

`figures.toml` beside the pages ties them; `benchmarks/figure_pages.py` says how. The tests run this too.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import figure_pages
import figure_sources

ROOT = Path(__file__).resolve().parents[1]
OWN_REPORT = Path("reports", "leaderboard")  # in .gitignore, so no page of the project can lie there


def page_problems(page: figure_pages.Page) -> Iterator[str]:
    """What is wrong with a page's figures and what it says of their origin, a line each."""
    yield from figure_pages.problems(page)
    yield from figure_sources.problems(page)


def unlisted(root: Path) -> list[str]:
    """Pages that may state a figure, and that no figures.toml has: all of reports/, and those of docs/ that name a
    quantity and aren't among its `settings`. The report that `dofbench report` writes where no other folder is given is
    the user's own, and not kept with the project."""
    listed = {page.file for page in figure_pages.read_pages(root)}
    settings = {(root / "docs" / name).resolve() for name in figure_pages.settings(root / "docs" / "figures.toml")}
    return [
        file.relative_to(root).as_posix()
        for folder in ("reports", "docs")
        for file in sorted((root / folder).rglob("*.md"))
        if file.resolve() not in listed | settings
        and not file.is_relative_to(root / OWN_REPORT)
        and (folder == "reports" or figure_pages.QUANTITY.search(file.read_text(encoding="utf-8")))
    ]


def main(folders: list[str]) -> int:
    """Print what is wrong; 1 if anything is, else 0."""
    pages = figure_pages.read_pages(ROOT)
    below = [Path(folder).resolve() for folder in folders]
    chosen = [page for page in pages if not below or any(page.file.is_relative_to(one) for one in below)]
    found = [f"{name}: in no figures.toml" for name in unlisted(ROOT)]
    found += [f"{page.file.relative_to(ROOT)}: {problem}" for page in chosen for problem in page_problems(page)]
    if figure_sources.has_history(ROOT):
        found += [
            f"{page.file.relative_to(ROOT)}: {problem}"
            for page in chosen
            for problem in figure_sources.commit_problems(page, ROOT)
        ]
    else:
        print("no git history here: commits weren't looked up")
    print("\n".join([*found, f"{len(chosen)} pages, {len(found)} problems"]))
    return bool(found)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
