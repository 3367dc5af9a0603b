"""The smallest circle of confusion, on planes where it is known by hand."""

import numpy as np
import pytest
from made_up import frontal
from tolerances import FLOAT32_VALUE

from dofbench.core.contracts import Rendering
from dofbench.core.lens import PhysicalLens
from dofbench.evaluation.scoring.resolved import ResolvedCircles, resolved_map, resolved_share

NEAR, FAR, WIDTH, HEIGHT = 2.0, 4.0, 40, 30


def _camera(x=0.0):
    return frontal(WIDTH, HEIGHT, 30.0, (x, 0.0, 0.0))


class Planes:
    """A far plane, and a near one over the left half of the world (x < 0)."""

    def render(self, camera, lens):
        x = (np.arange(WIDTH) + 0.5 - camera.cx) / camera.fx * NEAR + camera.centre[0]
        depth = np.broadcast_to(np.where(x < 0, NEAR, FAR), (HEIGHT, WIDTH)).astype(np.float32)
        return Rendering(np.zeros((HEIGHT, WIDTH, 3), np.float32), depth)


def test_the_smallest_circle_is_that_of_the_photograph_that_is_in_focus():
    lens_near, lens_far = PhysicalLens(40.0, 1 / NEAR, WIDTH), PhysicalLens(16.0, 1 / FAR, WIDTH)
    only_near = ResolvedCircles(Planes(), [(_camera(), lens_near)]).smallest(_camera())
    assert np.allclose(only_near[:, :20], 0, atol=FLOAT32_VALUE)
    assert np.allclose(only_near[:, 20:], 40 * (1 / NEAR - 1 / FAR), atol=FLOAT32_VALUE)
    both = ResolvedCircles(Planes(), [(_camera(), lens_near), (_camera(), lens_far)]).smallest(_camera())
    assert np.allclose(both, 0, atol=FLOAT32_VALUE)
    assert resolved_share(only_near) == pytest.approx(50) and resolved_share(both) == 100


def test_what_is_hidden_from_a_photograph_is_not_resolved_by_it():
    """Seen from the right, the near plane hides less of the far one: the strip beside it was seen by nobody."""
    circles = ResolvedCircles(Planes(), [(_camera(), PhysicalLens(0.1, 1 / FAR, WIDTH))]).smallest(_camera(0.5))
    far = Planes().render(_camera(0.5), None).depth == FAR
    unseen = np.isinf(circles)
    assert unseen.any() and not unseen[~far].any()
    assert resolved_share(circles) < 100


def test_nothing_to_see_is_no_share():
    class Nothing:
        def render(self, camera, lens):
            return Rendering(np.zeros((HEIGHT, WIDTH, 3), np.float32), np.zeros((HEIGHT, WIDTH), np.float32))

    circles = ResolvedCircles(Nothing(), [(_camera(), PhysicalLens(1.0, 0.5, WIDTH))]).smallest(_camera())
    assert np.isnan(circles).all() and np.isnan(resolved_share(circles))
    assert not resolved_map(circles).any()


def test_the_map_is_light_where_photographs_resolve():
    picture = resolved_map(np.array([[0.0, 5.0, np.inf, np.nan]])).astype(int).sum(axis=2)[0]
    assert picture[0] > picture[1] > picture[2] > picture[3] == 0
