"""Section IV of the paper: p(uncertain) is the Bayes posterior of the noise, and grows with the distance."""

from __future__ import annotations

import numpy as np
import pytest

from tools.evaluation.statistics import spearman
from tools.reproduce.theory import TheoryConfig, TheoryResult, check_theory, run_theory
from tools.reproduce.toy import expected_distance


@pytest.fixture(scope="module", params=[0, 1])
def result(request) -> TheoryResult:
    return check_theory(np.random.default_rng(request.param))


def test_uncertain_orders_space_as_the_bayes_posterior(result):
    assert spearman(result.uncertain, result.posterior) >= 0.99
    assert np.abs(result.uncertain - result.posterior).mean() < 0.025


def test_uncertain_orders_space_as_the_expected_distance(result):
    assert spearman(result.uncertain, result.distance) >= 0.99


def test_uncertain_rises_with_distance_in_bins(result):
    order = np.argsort(result.distance)
    means = [part.mean() for part in np.array_split(result.uncertain[order], 20)]
    assert (np.diff(means) > 0).all()
    assert means[-1] - means[0] > 0.4


def test_the_ordering_comes_from_the_data(result):
    # The same p(uncertain) against a distance to somewhere else must not pass.
    elsewhere = np.linalg.norm(result.points - [2.0, 0.0], axis=1)
    assert spearman(result.uncertain, elsewhere) < 0.9


def test_more_noise_means_more_uncertainty():
    few, many = (
        check_theory(np.random.default_rng(0), TheoryConfig(data_points=4000, noise_points=count, grid=21))
        for count in (1000, 8000)
    )
    assert (many.posterior > few.posterior).all()
    assert (many.uncertain > few.uncertain).mean() > 0.99


def test_expected_distance_is_the_mean_over_the_data():
    data = np.array([[0.0, 0.0], [3.0, 4.0]])
    np.testing.assert_allclose(expected_distance(np.zeros((5, 2)), data, rows=2), 2.5)


def test_figure_and_figures_are_written(tmp_path):
    small = TheoryConfig(data_points=2000, noise_points=2000, grid=21)
    figures = run_theory(tmp_path, 0, small)
    assert (tmp_path / "theory.png").stat().st_size > 1000
    assert set(figures) == {"spearman_posterior", "spearman_distance", "mean_absolute_error"}
