"""The options of `dofbench stability`."""

from __future__ import annotations

from pathlib import Path

from dofbench.core.options import options

# Group of cases -> its heading in the table; `<group>_cases` is the group's module.
GROUPS = {
    "lens": "Lens",
    "light": "Light",
    "invariants": "Invariants",
    "gaussians": "Gaussians",
    "fields": "Radiance fields",
    "images": "Images",
    "files": "Files",
    "datasets": "Datasets",
    "training": "Training",
    "gradients": "Gradients",
}


@options()
class Stability:
    """Run stiff and extreme cases and report which error bounds are met: as a table, and by the exit status."""

    kernel: str | None = None
    """Only the cases of this kernel: adam, colours, field, mix, rasterize, scatter, ssim, stereo, surface
    or tone."""
    method: str | None = None
    """Only the training of this method. Without it, of every method found."""
    group: tuple[str, ...] = ()
    """Only these groups: lens, light, invariants, gaussians, fields, images, files, datasets, training,
    gradients."""
    case: tuple[str, ...] = ()
    """Only these cases, by the names in the table."""
    out: Path = Path("reports/stability")
    """Folder for stability.csv and stability.md."""
    dry_run: bool = False
    """Only print the cases and the property that must hold in each; run none."""
