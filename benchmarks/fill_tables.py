"""Write the rows of tables that figures.toml describes whole into their pages.

    python benchmarks/fill_tables.py reports/baselines   # pages below a folder; all without one

`benchmarks/figure_tables.py` says how a table is described, `benchmarks/check_figures.py` notices one that is out of
date. Sentences are written by hand, since what they say hangs on the figures.
"""

from __future__ import annotations

import sys
from pathlib import Path

import figure_pages
import figure_tables

from dofbench.core.files import write_text

ROOT = Path(__file__).resolve().parents[1]


def main(folders: list[str]) -> int:
    """Fill in the pages and print which changed."""
    below = [Path(folder).resolve() for folder in folders]
    for page in figure_pages.read_pages(ROOT):
        if below and not any(page.file.is_relative_to(one) for one in below):
            continue
        tables = [
            (entry["head"], figure_tables.rows(entry, page.folder, page.names))
            for entry in page.given.get("table", [])
            if "each" in entry
        ]
        if tables and (text := figure_tables.filled(page.text, tables)) != page.text:
            write_text(page.file, text)
            print(f"wrote {page.file.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
