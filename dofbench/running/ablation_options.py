"""The options of `dofbench ablate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from dofbench.core.errors import InputError
from dofbench.core.options import OneBudget, options
from dofbench.evaluation.results.run_spec import CallOptions, SeveralOptions, command_line


@options(kw_only=True)
class Ablate(SeveralOptions, CallOptions):
    """Run ablation tables over datasets and seeds, and write them next to the paper's figures. A row's own options win
    over --set and --preset."""

    data: str
    """Dataset folders, comma-separated. A table of held-out lenses takes those made with --assign held-out, one of a
    single plane those made with --assign fixed, every other table all but the held-out ones."""
    table: str | None = None
    """Ids of the tables, comma-separated. Default: every table of the file that a dataset was given for."""
    method: str = "dofgaussian"
    """The method whose ablations.toml declares the tables."""
    tables: Path | None = None
    """Another file that declares the tables."""
    seeds: Annotated[int, Field(ge=1)] = 3
    """Seeds per row and dataset: 0, 1, ..."""
    budget: OneBudget = None
    """As of `dofbench run`, for every row. Default: the preset's."""
    preset: str | None = None
    """Preset of every row that names none itself. Default: the method's."""
    results: Path = Path("results")
    """Folder of results, as `dofbench run` writes them; cached results are used."""
    out: Path = Path("reports/ablation")
    """Folder for the tables."""

    def __post_init__(self) -> None:
        if not self.folders:
            raise InputError("--data", repr(self.data), "dataset folders, comma-separated")

    @property
    def folders(self) -> tuple[Path, ...]:
        """The datasets' folders."""
        return tuple(Path(part.strip()) for part in self.data.split(",") if part.strip())

    @property
    def ids(self) -> tuple[str, ...]:
        """The tables asked for by id; none means all."""
        return tuple(part.strip() for part in (self.table or "").split(",") if part.strip())

    def command(self) -> str:
        """The command line that says the same, with what is not the default; paths as they were given."""
        return command_line("ablate", self, without=("dry_run", "verbose", "on", "slurm"))
