"""What decides whether a run needs a stage: each decider looks at facts about the training photographs.

A method's card names, for every stage that a plan may skip, the decider that it asks (`StageCard.decided_by`). The
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
    """needless: whether the stage could be skipped. why: the fact that decided.

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
        return Verdict(False, "unknown blur radius", to_be_tried=True)
    shown = f"estimated CoC radius up to {blur:.2f} px; images in focus give up to {NEEDLESS_BLUR} px"
    needless = blur < NEEDLESS_BLUR
    if needless and asked.sharp:
        return Verdict(True, f"{shown}; trained on all-in-focus images")
    # Points are found where a photograph is sharp, so what they show can't tell that there is no lens.
    return Verdict(needless, shown, to_be_tried=blur < CLEAR_BLUR)


def _f_numbers(asked: Asked) -> Verdict | None:
    """Whether EXIF says how the photographs' apertures compare, so that they need no aperture each."""
    if not asked.runs.get("lens", True) or asked.facts.one_lens is not None:
        return None
    if asked.facts.f_numbers:
        return Verdict(
            True,
            "EXIF has every f-number, of one camera at one focal length: shared aperture x f-number, per-view focus",
        )
    return Verdict(False, "EXIF has no comparable f-numbers")


def _one_lens(asked: Asked) -> Verdict | None:
    """Whether one lens took all photographs, so that they need no lens each."""
    if not asked.runs.get("lens", True) or not asked.runs.get("f_numbers", True):
        return None
    one = asked.facts.one_lens
    if one is None:
        return Verdict(False, "no lens metadata", to_be_tried=True)
    if one:
        return Verdict(True, "the dataset has one shared lens")
    return Verdict(False, "the dataset has several lenses")


def _blur_model(asked: Asked) -> Verdict | None:
    """Which model of a blur explains the photographs: no fact tells."""
    if not asked.runs.get("lens", True):
        return None
    return Verdict(False, "unknown blur model", to_be_tried=True, only_tried=True)


def _points(asked: Asked) -> Verdict:
    """Whether there are sparse points."""
    return Verdict(not asked.facts.points, f"{asked.facts.points or 'no'} sparse points")


def _depth_supervision(asked: Asked) -> Verdict:
    """Whether the depth is supervised, by the stage that asks for points."""
    if asked.runs.get("points", True):
        return Verdict(False, "normals need depth supervision")
    return Verdict(True, "normals need depth supervision, which is off")


def _view_dependence(asked: Asked) -> Verdict:
    """Whether surfaces change their colour with the direction from which they are seen."""
    spread = asked.facts.view_dependence
    if spread is None:
        return Verdict(False, "too few points with enough views")
    return Verdict(
        spread < NEEDLESS_DEPENDENCE,
        f"colours change by {spread:.1f} of 255 levels with the viewing direction; visible from {NEEDLESS_DEPENDENCE}",
    )


def _colour_spread(asked: Asked) -> Verdict:
    """Whether the photographs differ in exposure or white balance."""
    spread, light = asked.facts.colour_spread, asked.facts.light_spread
    if spread is not None:
        return Verdict(
            spread < NEEDLESS_COLOURS,
            f"exposure and white balance differ by {spread:.1f} % over the views; threshold {NEEDLESS_COLOURS:.0f} %",
        )
    if light is not None:
        return Verdict(
            light < NEEDLESS_LIGHT,
            f"EXIF exposures differ by {light:.1f} stops; threshold {NEEDLESS_LIGHT}; too few shared points",
        )
    return Verdict(True, "unknown exposure and white balance: too few shared points, no EXIF")


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
