"""The comparison of two decoders' points pairs the points of one firing only."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.acceptance.decoded import LIMIT_M, worst_excess_m
from zloam_monitor.messages import POINT

FIRINGS, FIRING_NS = 200, 55_296
RANGE_M = 2.0


def a_ring(returns: int = 1) -> NDArray[Any]:
    """One ring of a round room; further returns of a firing lie 1 m behind the first."""
    firing = np.repeat(np.arange(FIRINGS), returns)
    range_m = RANGE_M + np.tile(np.arange(returns), FIRINGS)
    points = np.zeros(len(firing), POINT)
    points["x"] = range_m * np.cos(0.0034 * firing)
    points["y"] = range_m * np.sin(0.0034 * firing)
    points["time_ns"] = FIRING_NS * firing
    return points


def test_the_returns_of_one_firing_may_be_swapped() -> None:
    ours = a_ring(returns=2)
    theirs = ours.reshape(-1, 2)[:, ::-1].ravel()
    assert worst_excess_m(ours, theirs)[0] == 0.0


@pytest.mark.parametrize("returns", [1, 2])
def test_points_that_are_a_firing_late_are_misplaced(returns: int) -> None:
    ours = a_ring(returns)
    _, excess_m = worst_excess_m(ours, np.roll(ours, returns))
    assert excess_m > LIMIT_M


def test_a_coordinate_that_is_no_number_is_refused() -> None:
    ours = a_ring()
    ours["z"][7] = np.nan
    with pytest.raises(RuntimeError, match="no number"):
        worst_excess_m(ours, a_ring())
