"""What decides whether a run needs a stage: each decider looks at facts about the training photographs.

A method's card names, for every stage that a plan may leave out, the decider that it asks (`StageCard.decided_by`). The
facts and their thresholds are here and the same for all methods.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from dofbench.methods.stages.facts import Facts

NEEDLESS_BLUR = 0.75  # px, estimated radius: photographs that are all in focus give estimates of up to 0.6
CLEAR_BLUR = 2.0  # px: a larger estimate is proof enough that there is a lens, so nothing has to be tried
NEEDLESS_DEPENDENCE = 2.5  # levels of 255: nobody would see the harmonics of a smaller change
NEEDLESS_COLOURS = 12.0  # per cent: at 10 learned colours gained nothing, at 21 they gained a decibel
NEEDLESS_LIGHT = 0.3  # stops by EXIF, used where too few points are shared


@dataclass(frozen=True)
class Asked:
    """What a decider looks at.

    facts: about the training photographs. sharp: the call says that they are all in focus. runs: for each decider that
    was asked before, whether the stage that asked it runs.
    """

    facts: Facts
    sharp: bool
    runs: Mapping[str, bool]


@dataclass(frozen=True)
class Verdict:
    """needless: whether the stage could be left out. why: the fact that decided.

    to_be_tried: whether the stage runs and training finds out if it is needed, of a method that can try that.
    only_tried: no fact decides, so that the plan mentions the stage only where training tries it.
    """

    needless: bool
    why: str
    to_be_tried: bool = False
    only_tried: bool = False


def _lens(asked: Asked) -> Verdict:
    """Whether the photographs show any blur."""
    blur = asked.facts.blur_px
    if blur is None:
        return Verdict(False, "the photographs don't tell how blurred they are", to_be_tried=True)
    shown = (
        f"the photographs show circles of confusion of up to {blur:.2f} px radius, by an estimate that gives up to "
        f"{NEEDLESS_BLUR} px for photographs without blur"
    )
    needless = blur < NEEDLESS_BLUR
    if needless and asked.sharp:
        return Verdict(True, f"{shown}, and the call says that they are all in focus")
    # Points are found where a photograph is sharp, so what they show can't tell that there is no lens.
    return Verdict(needless, shown, to_be_tried=blur < CLEAR_BLUR)


def _f_numbers(asked: Asked) -> Verdict | None:
    """Whether EXIF says how the photographs' apertures compare, so that they need no aperture each."""
    if not asked.runs.get("lens", True) or asked.facts.one_lens is not None:
        return None
    if asked.facts.f_numbers:
        return Verdict(
            True,
            "EXIF has the f-number of every photograph, by one camera at one focal length: aperture x f-number is "
            "learned once for all, and a focus for each",
        )
    return Verdict(False, "EXIF doesn't say how the photographs' apertures compare")


def _one_lens(asked: Asked) -> Verdict | None:
    """Whether one lens took all photographs, so that they need no lens each."""
    if not asked.runs.get("lens", True) or not asked.runs.get("f_numbers", True):
        return None
    one = asked.facts.one_lens
    if one is None:
        said = "nobody knows the photographs' lenses, so each may have one of its own"
        return Verdict(False, said, to_be_tried=True)
    if one:
        return Verdict(True, "the dataset says: one lens took all photographs")
    return Verdict(False, "the dataset says: photographs by several lenses")


def _blur_model(asked: Asked) -> Verdict | None:
    """Which model of a blur explains the photographs: no fact tells."""
    if not asked.runs.get("lens", True):
        return None
    return Verdict(False, "nobody knows how the photographs were blurred", to_be_tried=True, only_tried=True)


def _points(asked: Asked) -> Verdict:
    """Whether there are sparse points."""
    return Verdict(not asked.facts.points, f"{asked.facts.points or 'no'} sparse points")


def _depth_supervision(asked: Asked) -> Verdict:
    """Whether the depth is supervised, by the stage that asks for points."""
    if asked.runs.get("points", True):
        return Verdict(False, "normals smooth the surfaces that depth supervision has placed")
    return Verdict(True, "normals smooth surfaces that depth supervision has placed, and there is none")


def _view_dependence(asked: Asked) -> Verdict:
    """Whether surfaces change their colour with the direction from which they are seen."""
    spread = asked.facts.view_dependence
    if spread is None:
        return Verdict(False, "too few points are seen often enough to tell")
    return Verdict(
        spread < NEEDLESS_DEPENDENCE,
        f"surfaces change by {spread:.1f} of 255 levels with the viewing direction; {NEEDLESS_DEPENDENCE} can be seen",
    )


def _colour_spread(asked: Asked) -> Verdict:
    """Whether the photographs differ in exposure or white balance."""
    spread, light = asked.facts.colour_spread, asked.facts.light_spread
    if spread is not None:
        return Verdict(
            spread < NEEDLESS_COLOURS,
            f"exposure and white balance differ by {spread:.1f} % over the photographs; "
            f"below {NEEDLESS_COLOURS:.0f} % they need no colours of their own",
        )
    if light is not None:
        return Verdict(
            light < NEEDLESS_LIGHT,
            f"too few points are shared to compare colours; by EXIF the light that the camera let in differs by "
            f"{light:.1f} stops, and below {NEEDLESS_LIGHT} stops photographs need no colours of their own",
        )
    why = "too few points are shared to tell whether exposure or white balance differ, and EXIF doesn't tell"
    return Verdict(True, why)


# A decider gives None where there is no question: without a lens nobody asks whether there is one for each view.
DECIDERS: dict[str, Callable[[Asked], Verdict | None]] = {
    "lens": _lens,
    "f_numbers": _f_numbers,
    "one_lens": _one_lens,
    "blur_model": _blur_model,
    "points": _points,
    "depth_supervision": _depth_supervision,
    "view_dependence": _view_dependence,
    "colour_spread": _colour_spread,
}
LENS_DECIDERS = ("lens", "f_numbers", "one_lens", "blur_model")  # of a method that learns a lens
