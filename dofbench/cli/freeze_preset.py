"""`dofbench methods ID --freeze PRESET`: freeze a preset, so that it may be run on report scenes."""

from __future__ import annotations

from dofbench.methods.cards import find_method
from dofbench.methods.frozen_presets import FROZEN_FILE, freeze


def freeze_preset(method: str, preset: str) -> None:
    """Freeze the preset and print what its entry says. Raises InputError as `freeze` does."""
    frozen = freeze(method, preset)
    file = find_method(method).folder / FROZEN_FILE
    print(f"preset {preset} of {method} is frozen at commit {frozen.commit[:12]}, digest {frozen.digest[:16]}: {file}")
