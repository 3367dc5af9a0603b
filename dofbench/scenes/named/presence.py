"""Is a named scene here, and is it whole?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from dofbench.core.errors import InputError
from dofbench.scenes.named.named_scene import ResolvedScene
from dofbench.scenes.named.places import same_files
from dofbench.scenes.readers.folders import marked_hold

# "here": readable, and there is no published checksum to compare with.
State = Literal["complete", "here", "incomplete", "different", "unreadable", "absent"]


@dataclass(frozen=True)
class Presence:
    """What was found of a scene. detail: one line; training, test: numbers of views, 0 where it can't be read."""

    scene: ResolvedScene
    state: State
    detail: str
    training: int = 0
    test: int = 0

    @property
    def is_problem(self) -> bool:
        """Whether something is here that isn't as it should be."""
        return self.state in ("incomplete", "different", "unreadable")


def inspect(scene: ResolvedScene) -> Presence:
    """Look for a scene's files: readable, as many views as there must be, of the size and checksums that are known.

    Image headers are read, and no pixels.
    """
    if scene.missing:
        return Presence(scene, "absent", scene.missing)
    if scene.layout == "blb":
        return Presence(scene, "here", "single views for validate-renderer")
    try:
        loaded = scene.load()
    except InputError as error:
        return Presence(scene, "unreadable", str(error))
    training = sum(view.split == "train" for view in loaded.views)
    test, views = len(loaded.views) - training, len(loaded.views)
    camera = loaded.views[0].camera
    counted = f"{training} + {test} test, {camera.width}x{camera.height}"
    if scene.views is not None and views != scene.views:
        state: State = "incomplete" if views < scene.views else "different"
        return Presence(scene, state, f"{views} views in {scene.root}, expected {scene.views}", training, test)
    if scene.size is not None and scene.size != (camera.width, camera.height):
        expected = f"{scene.size[0]}x{scene.size[1]}"
        return Presence(scene, "different", f"{counted} in {scene.root}, expected {expected}", training, test)
    marked = marked_hold(scene.root)
    if scene.hold is not None and marked is not None and marked != scene.hold:
        detail = f"a marker hold={marked} in {scene.root}, expected hold={scene.hold}"
        return Presence(scene, "different", detail, training, test)
    if other := same_files(scene.root, scene.sha256):
        return Presence(scene, "different", f"{scene.root / other} has another checksum than recorded", training, test)
    return Presence(scene, "here" if scene.views is None else "complete", counted, training, test)
