"""Tests the statistics of the NEES checks on draws with a known covariance."""

from __future__ import annotations

import numpy as np
import pytest

from tests.acceptance.consistency import consistency, nees

RUNS = 10
DRAWS = 400


def _share_held(rng: np.random.Generator, samples: int, factor: float) -> float:
    """Share of many simulated sets of runs that are accepted; a run is worth `samples` independent
    samples, and the squared errors are off by `factor`."""
    runs = factor * rng.chisquare(3 * samples, (DRAWS, RUNS)) / samples
    return float(np.mean([consistency(r).held for r in runs]))


def test_nees_of_errors_drawn_from_their_covariances_is_three() -> None:
    rng = np.random.default_rng(1)
    roots = rng.normal(size=(5000, 3, 3)) + 2.0 * np.eye(3)
    errors = np.einsum("nij,nj->ni", roots, rng.normal(size=(5000, 3)))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    assert nees(errors, covariances) == pytest.approx(3.0, abs=0.15)
    assert nees(errors, 4.0 * covariances) == pytest.approx(0.75, abs=0.04)


@pytest.mark.parametrize("samples", [3, 20, 300])
def test_nineteen_in_twenty_are_held_however_many_samples_a_run_is_worth(samples: int) -> None:
    assert _share_held(np.random.default_rng(2), samples, 1.0) == pytest.approx(0.95, abs=0.035)


@pytest.mark.parametrize("factor", [0.7, 1.4])
def test_sigmas_that_are_off_by_a_fifth_are_not_held(factor: float) -> None:
    assert _share_held(np.random.default_rng(3), 20, factor) < 0.02
