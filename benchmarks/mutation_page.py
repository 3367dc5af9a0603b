"""The page of a mutation run: its counts, and the survivors with their reasons."""

from __future__ import annotations

import csv
import platform
import tomllib
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from dofbench.core.files import replacing

PARTS = (
    ("optics", "dofbench/optics/"),
    ("learning", "dofbench/learning/"),
    ("gaussians", "dofbench/gaussians/"),
    ("metrics", "dofbench/metrics/"),
    ("statistics of pairs", "dofbench/reporting/"),
    ("references of the kernels", "kernels/"),
)


def write_page(out: Path, rows: Sequence[dict[str, str]], *, seed: int, count: int, killed: Sequence[str]) -> None:
    """README.md in `out` of the rows of mutants.csv; the survivors' reasons are those of survivors.toml, by id: `kind`
    (equivalent or gap) and `reason`."""
    reasons = survivors(out)
    dead = [row for row in rows if row["outcome"] in killed]
    commits = " and ".join(sorted({row["commit"] for row in rows}))
    seconds = sorted(float(row["seconds"]) for row in rows)
    alive = [row for row in rows if row["outcome"] not in killed]
    equal = [row for row in alive if reasons.get(row["id"], {}).get("kind") == "equivalent"]
    others = [row for row in rows if row not in equal]
    parts = [(name, [row for row in rows if row["file"].startswith(start)]) for name, start in PARTS]
    kinds = sorted({row["operator"] for row in rows})
    code, module = "../../benchmarks/mutation_run.py", "../../benchmarks/mutation_sites.py"
    lines = [
        "# Do the tests notice when the code changes?",
        "",
        f"Of {len(rows)} mutants drawn at random, {len(dead)} were killed: **{_share(dead, rows)}**. A mutant is the "
        "code with one small change; it is killed if a test fails that passes without the change. "
        f"{len(equal)} of the survivors are equivalent to the code; of all others {_share(dead, others)} were killed.",
        "",
        "Tests were added for what survived of this very draw, so the share isn't that of mutants in general. "
        + _first(out, killed),
        *([] if len(rows) >= count else ["", f"The run isn't finished: {count} are drawn."]),
        "",
        "```sh",
        f"python benchmarks/mutation_run.py --seed {seed} --count {count} --out reports/mutation",
        "```",
        "",
        f"Run at commit {commits}, in {platform.python_implementation()} {platform.python_version()} on one core of "
        f"{platform.machine()}. Every mutant, with the test that killed it: [mutants.csv](mutants.csv). Median "
        f"{seconds[len(seconds) // 2]:.1f} s, mean {sum(seconds) / len(seconds):.1f} s a mutant. How they are drawn: "
        f"[mutation_run.py]({code}); what is changed, and what never is: [mutation_sites.py]({module}).",
        "",
        *_table("code", parts, killed),
        "",
        *_table("change", [(kind, [row for row in rows if row["operator"] == kind]) for kind in kinds], killed),
        "",
        "How they were killed: "
        + ", ".join(f"{name} {number}" for name, number in Counter(row["outcome"] for row in dead).most_common())
        + ".",
        "",
        "## Survivors",
        "",
    ]
    for kind, heading in (
        ("equivalent", "Equivalent: the change makes no difference that a user could see."),
        ("gap", "Gaps: a test could notice, and none does."),
        ("", "Without a reason yet."),
    ):
        those = [row for row in alive if reasons.get(row["id"], {}).get("kind", "") == kind]
        if those:
            lines += [heading, "", "| where | before | after | reason |", "| --- | --- | --- | --- |"]
            lines += [
                f"| `{row['file']}` {_code(row['function'] or 'at import')}, {row['id']} | {_code(row['before'])} | "
                f"{_code(row['after'])} | {reasons.get(row['id'], {}).get('reason', row['outcome'])} |"
                for row in those
            ]
            lines.append("")
    with replacing(out / "README.md") as temporary:
        temporary.write_text("\n".join(lines).rstrip() + "\n")


def _first(out: Path, killed: Sequence[str]) -> str:
    """What became of a draw that no test knew (fresh/mutants.csv)."""
    file = out / "fresh" / "mutants.csv"
    if not file.is_file():
        return "A first run with another `--seed` tells that."
    with file.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    dead = [row for row in rows if row["outcome"] in killed]
    return (
        f"In the first run of the last new draw tests that didn't know it killed **{_share(dead, rows)}** (commit "
        f"{rows[0]['commit']}: [{len(dead)} of {len(rows)}](fresh/mutants.csv))."
    )


def survivors(out: Path) -> dict[str, dict[str, str]]:
    """What survivors.toml in the folder says, by id: `kind` and `reason`."""
    file = out / "survivors.toml"
    return tomllib.loads(file.read_text()) if file.is_file() else {}


def _table(name: str, groups: Sequence[tuple[str, list[dict[str, str]]]], killed: Sequence[str]) -> list[str]:
    lines = [f"| {name} | mutants | killed | share |", "| --- | --- | --- | --- |"]
    for label, rows in groups:
        if rows:
            dead = [row for row in rows if row["outcome"] in killed]
            lines.append(f"| {label} | {len(rows)} | {len(dead)} | {_share(dead, rows)} |")
    return lines


def _share(part: Sequence[object], whole: Sequence[object]) -> str:
    return f"{100 * len(part) / len(whole):.1f} %" if whole else "–"


def _code(text: str) -> str:
    return "`" + text.replace("|", "\\|").replace("`", "'") + "`"
