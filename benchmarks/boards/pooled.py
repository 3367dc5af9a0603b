"""Differences from one method over the scenes of the headline board, whose rows several versions of the code made.

    python -m benchmarks.boards.pooled RUNS lensselect reports/boards/scenes-pooled.csv

RUNS has the results of the blocks in reports/boards/results, unpacked. A report compares runs of one version alone;
here a method's runs on defocused photographs are taken together. Methods that ran on fewer of the scenes than the one
they are compared with are left out. Test and interval are those of reports, p by Holm over the pairs.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from dofbench.core.files import write_csv
from dofbench.evaluation.comparing.paired import adjusted, compare
from dofbench.evaluation.results.collecting import Entry, collect

COLUMNS = ("aif_psnr", "psnr")


def finished(runs: Path) -> dict[str, dict[str, Entry]]:
    """Method, and options that aren't its preset's -> scene -> its good run on defocused photographs."""
    found: dict[str, dict[str, Entry]] = {}
    for one in collect(runs).entries:
        if one.status == "ok" and one.spec.protocol.startswith("refocus"):
            method = " ".join([one.spec.method, *(f"{name}={value}" for name, value in one.spec.overrides.items())])
            scenes = found.setdefault(method, {})
            if one.scene in scenes:
                raise SystemExit(f"{one.folder}: a second run of {method} on {one.scene}")
            scenes[one.scene] = one
    return found


def main() -> None:
    """Write the CSV."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, help="folder of results")
    parser.add_argument("against", help="method that the others are compared with")
    parser.add_argument("out", type=Path, help="CSV to write")
    asked = parser.parse_args()
    found = finished(asked.runs)
    scenes = sorted(found[asked.against])
    methods = sorted(one for one, ran in found.items() if one != asked.against and ran.keys() >= set(scenes))
    rows: list[dict[str, Any]] = []
    for column in COLUMNS:
        pairs = [[([found[one][scene]], [found[asked.against][scene]]) for scene in scenes] for one in methods]
        for method, one in zip(methods, adjusted([compare(groups, column) for groups in pairs]), strict=True):
            difference = one.difference
            if difference is None:
                continue
            rows.append(
                {
                    "method": method,
                    "against_method": asked.against,
                    "column": column,
                    "scenes": " ".join(scenes),
                    "pairs": difference.pairs,
                    "above": difference.above,
                    "difference": difference.mean,
                    "low": difference.low,
                    "high": difference.high,
                    "p": difference.p,
                }
            )
    write_csv(asked.out, tuple(rows[0]), rows)


if __name__ == "__main__":
    main()
