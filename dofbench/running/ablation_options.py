"""What a call of `dofbench ablate` says."""

from __future__ import annotations

import shlex
from dataclasses import dataclass, fields
from pathlib import Path

from dofbench.core.errors import InputError


@dataclass(frozen=True)
class Ablate:
    """Run declared tables of switches over datasets and seeds, and write them beside the paper's figures."""

    data: str
    """Dataset folders, comma-separated. A table of held-out lenses takes those made with --assign held-out, one of a
    single plane those made with --assign fixed, every other table all but the held-out ones."""
    table: str | None = None
    """Ids of the tables, comma-separated. Default: every table of the file that a dataset was given for."""
    tables: Path | None = None
    """File that declares the tables. Default: methods/dofgaussian/ablations.toml."""
    seeds: int = 3
    """Seeds per row and dataset: 0, 1, ..."""
    budget: str | None = None
    """As of `dofbench run`, for every row. Default: the preset's."""
    preset: str | None = None
    """Preset of every row that names none itself. Default: the method's."""
    set: tuple[str, ...] = ()
    """Options for every row that doesn't set them itself, as of `dofbench run`."""
    device: str = "auto"
    """As of `dofbench run`."""
    jobs: int = 1
    """Runs at the same time, each in a process of its own with its share of the threads."""
    results: Path = Path("results")
    """Folder of results, as `dofbench run` writes them; what is finished there isn't run again."""
    out: Path = Path("reports/ablation")
    """Folder for the tables."""
    dry_run: bool = False
    """Print the runs, which of them are finished, and an estimate of the time; stop there."""

    def __post_init__(self) -> None:
        for option, value in (("--seeds", self.seeds), ("--jobs", self.jobs)):
            if value < 1:
                raise InputError(option, str(value), "at least 1")
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
        words = ["dofbench", "ablate"]
        for field in fields(self):
            value = getattr(self, field.name)
            if value == field.default or field.name == "dry_run":
                continue
            words.append("--" + field.name.replace("_", "-"))
            words.extend(value if isinstance(value, tuple) else [str(value)])
        return shlex.join(words)
