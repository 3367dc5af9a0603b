"""Compare finished runs, such as that of 04_train_and_score.py: one line for each, and a report of all.

python examples/05_read_results.py
"""

from pathlib import Path

import dofbench


def main(results: Path = Path("results"), out: Path = Path("reports/example")) -> None:
    """results: a folder of results. out: the report's folder."""
    for file in sorted(results.rglob("result.json")):
        result = dofbench.read_result(file)
        spec = result.spec
        scores = ", ".join(
            f"{column} {result.scores[column]:.2f}" for column in ("psnr", "aif_psnr") if column in result.scores
        )
        print(f"{spec.dataset}, {spec.method} {spec.preset}, seed {spec.seed}: {result.status}, {scores}")

    written = dofbench.report(dofbench.Report(results=results, out=out))  # tables, curves, and one page with everything
    print(f"{len(written.files)} files, {out / 'report.html'} first")


if __name__ == "__main__":
    main()
