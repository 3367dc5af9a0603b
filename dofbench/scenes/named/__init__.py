"""Named datasets: what `datasets/*.toml` says of them, and where their scenes are on this machine."""

from dofbench.scenes.named.library import named_datasets, source_of
from dofbench.scenes.named.places import VARIABLE, Reading, ResolvedScene, find_data_root, scenes_of, what_to_put
from dofbench.scenes.named.resolve import find_named, resolve
from dofbench.scenes.named.schema import Archive, LeftOut, NamedDataset, NamedScene, Recipe

__all__ = [
    "VARIABLE",
    "Archive",
    "LeftOut",
    "NamedDataset",
    "NamedScene",
    "Reading",
    "Recipe",
    "ResolvedScene",
    "find_data_root",
    "find_named",
    "named_datasets",
    "resolve",
    "scenes_of",
    "source_of",
    "what_to_put",
]
