"""Named datasets: what `datasets/*.toml` says of them, and where their scenes are on this machine."""

from dofbench.scenes.named.library import named_datasets
from dofbench.scenes.named.places import Reading, ResolvedScene, find_data_root, scenes_of
from dofbench.scenes.named.resolve import resolve
from dofbench.scenes.named.schema import LeftOut, NamedDataset, NamedScene, Recipe

__all__ = [
    "LeftOut",
    "NamedDataset",
    "NamedScene",
    "Reading",
    "Recipe",
    "ResolvedScene",
    "find_data_root",
    "named_datasets",
    "resolve",
    "scenes_of",
]
