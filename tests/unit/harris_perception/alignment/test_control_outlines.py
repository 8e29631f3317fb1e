"""Shifts of a control's outline, and their certainty: only a shift that explains the image alone is certain."""

from __future__ import annotations

import numpy as np
import pytest

from harris_perception.core.alignment.control_outlines import _common, _step
from icu_common.core.geometry.geometry import Array

STEPS_MM = 0.05 * np.arange(-64, 65)
NO_WALLS = (0.0, 0.0)


def side(edges: dict[float, float]) -> Array:
    """Return a profile, measured outward, with a step of grey values at each given place in mm."""
    return np.asarray(150.0 + sum(grey * _step((STEPS_MM - at) / 0.3) for at, grey in edges.items()))


def ends(shift: float, *edges: tuple[float, float]) -> tuple[Array, Array]:
    return side({at + shift: grey for at, grey in edges}), side({at - shift: grey for at, grey in edges})


@pytest.mark.parametrize("shift", [0.0, 0.23, -0.8])
def test_a_shift_is_found(shift: float) -> None:
    found = _common(ends(shift, (0.0, -80.0)), NO_WALLS)
    assert found is not None
    assert found[0] == pytest.approx(shift, abs=0.03) and found[1] < 0.1


def test_a_bevel_is_no_shift() -> None:
    found = _common(ends(0.0, (-0.7, -20.0), (0.0, -80.0)), NO_WALLS)
    assert found is not None and abs(found[0]) < 0.05


def test_two_bevels_that_explain_different_shifts_make_it_uncertain() -> None:
    """One end shows a bevel of 0.4 mm, the other of 0.8 mm: the edges cannot be assigned to the ends."""
    first, second = side({-0.4: -40.0, 0.0: -40.0}), side({-0.8: -40.0, 0.0: -40.0})
    found = _common((first, second), NO_WALLS)
    assert found is None or found[1] > 0.05


@pytest.mark.parametrize("shift", [1.6, -2.5])
def test_a_figure_out_of_reach_is_not_measured(shift: float) -> None:
    assert _common(ends(shift, (0.0, -80.0)), NO_WALLS) is None


def test_a_flat_side_is_not_measured() -> None:
    assert _common((side({0.0: -80.0}), side({0.0: -2.0})), NO_WALLS) is None
