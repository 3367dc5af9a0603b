"""Declared tables of switches, run over datasets and seeds, beside the published figures."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:  # importing this package must stay cheap: the command line does it for its help
    from dofbench.ablation.settings import Ablate

__all__ = ["ablate"]


def ablate(settings: Ablate) -> bool:
    """Run what isn't finished and write the tables; see `dofbench.ablation.make`. False when a run failed."""
    from dofbench.ablation.make import make_tables

    return make_tables(settings)
