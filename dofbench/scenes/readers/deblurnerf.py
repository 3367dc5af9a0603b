"""Deblur-NeRF's layout (Ma et al. 2022): LLFF's, with blurred photographs and sharp ones among them to test with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from dofbench.core.errors import InputError
from dofbench.scenes.readers import llff
from dofbench.scenes.readers.folders import choose_folder, marked_hold
from dofbench.scenes.scene import Scene


def fits(root: Path) -> bool:
    """Never: no file tells the layout from LLFF's, as the marker hold=N may stand in any folder."""
    return False


def read(root: Path, *, width: int | None, images: str | None, hold: int | None, skip_missing: bool = False) -> Scene:
    """Read the layout; see `load_scene`.

    Views 0, hold, 2 hold, ... are sharp, all others blurred. A wrong hold would train on the one and test with the
    other, so it is never guessed: it is given or marked. Without width and images: images_4, where it is there (the
    real scenes are read at a quarter of their size), else images.
    """
    chosen = marked_hold(root) if hold is None else hold
    if chosen is None:
        raise InputError(root, "no marker file hold=N and no hold", "one of them: it says which photographs are sharp")
    folder = choose_folder(root, width=width, images=images, habit=(4, 1))
    scene = llff.read_folder(root, folder, width=width, skip_missing=skip_missing).with_hold(chosen)
    by = f"hold {chosen} ({'as asked' if hold is not None else 'marker file'})"
    scene = replace(scene, split_by=by)
    return replace(scene.taken_as(train="shallow", test="all-in-focus"), layout="deblurnerf")
