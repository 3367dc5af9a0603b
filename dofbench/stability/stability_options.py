"""What a call of `dofbench stability` says."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

# A group of cases is a module of this name; and its heading in the table.
GROUPS = {
    "lens": "Lens",
    "light": "Light",
    "invariants": "Invariants",
    "gaussians": "Gaussians",
    "images": "Images",
    "files": "Files",
    "datasets": "Datasets",
    "training": "Training",
    "gradients": "Gradients",
}


@dataclass(frozen=True)
class Stability:
    """Run stiff and extreme cases and say which of their bounds are met: a table and an exit status."""

    kernel: str | None = None
    """Only the cases of this kernel: rasterize, scatter, ssim or stereo."""
    method: str | None = None
    """Only the training of this method. Without it, of every method that is found."""
    group: tuple[str, ...] = ()
    """Only these groups: lens, light, invariants, gaussians, images, files, datasets, training, gradients."""
    case: tuple[str, ...] = ()
    """Only these cases, by the names in the table."""
    out: Path = Path("reports/stability")
    """Folder for stability.csv and stability.md."""
    dry_run: bool = False
    """Print the cases, and what must hold in each, and run nothing."""
