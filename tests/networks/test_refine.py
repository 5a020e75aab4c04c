import numpy as np
import pytest
import torch
from plane_samples import REFINE, awake, random_planes

from omnisyn_cli.networks.refine import (
    AGREED_PLANE,
    CANDIDATES,
    CAUTION,
    DRAW,
    FILLED_PLANE,
    MATCHED_PLANE,
    SKY_PLANE,
    SUGGESTED,
    WINDOWS,
    RefineNetwork,
    RefinePrediction,
    candidates_of,
)


@pytest.fixture(scope="module")
def network():
    return awake(REFINE)


def test_a_fresh_network_nearly_leaves_matching_alone():
    torch.manual_seed(0)
    given = random_planes()
    with torch.no_grad():
        answer = RefineNetwork(REFINE)(given)
    assert answer.root().shape == (1, 1, 32, 64)
    assert (answer.root() - given[:, FILLED_PLANE : FILLED_PLANE + 1]).abs().max() < 0.5


def test_where_matching_is_sure_its_answer_stays(network):
    given = random_planes()
    with torch.no_grad():
        root = network(given).root()
    sure = (given[:, AGREED_PLANE] + given[:, SKY_PLANE] > 0)[:, None]
    filled = given[:, FILLED_PLANE : FILLED_PLANE + 1]
    torch.testing.assert_close(root[sure], filled[sure], rtol=0.0, atol=0.0)
    assert (root - filled)[~sure].abs().mean() > 0.05


def test_candidates_are_the_extremes_of_windows_around_the_seam():
    """Against plain loops."""
    given = random_planes(19, 12, 24)
    found = candidates_of(given)[0].numpy()
    assert len(found) == SUGGESTED
    filled = given[0, FILLED_PLANE].numpy()
    np.testing.assert_array_equal(found[0], filled)
    np.testing.assert_array_equal(found[1], given[0, MATCHED_PLANE].numpy())
    for k, window in enumerate(WINDOWS):
        reach = window // 2
        for row in range(12):
            rows = filled[max(0, row - reach) : row + reach + 1]
            for col in range(24):
                square = rows[:, np.arange(col - reach, col + reach + 1) % 24]
                assert found[2 + 2 * k, row, col] == square.max()
                assert found[3 + 2 * k, row, col] == square.min()


def test_the_answer_is_the_candidate_of_least_expected_error():
    """Against a weighted median by sorting: the same, or as good within what counts as a draw."""
    rng = np.random.default_rng(0)
    candidates = rng.random((CANDIDATES, 50))
    logits = rng.normal(0.0, 8.0, (CANDIDATES, 50))
    zero = torch.zeros((1, 1, 1, 50), dtype=torch.float64)
    given = (torch.from_numpy(array).reshape(1, CANDIDATES, 1, 50) for array in (candidates, logits))
    found = RefinePrediction(*given, zero, zero, zero).root().numpy().ravel()
    shares = np.exp(CAUTION * logits) / np.exp(CAUTION * logits).sum(axis=0)
    order = np.argsort(candidates, axis=0)
    below = np.cumsum(np.take_along_axis(shares, order, 0), axis=0)
    median = np.take_along_axis(candidates, np.take_along_axis(order, (below < 0.5).sum(axis=0)[None], 0), 0)[0]
    errors = [(shares * np.abs(candidates - answer)).sum(axis=0) for answer in (found, median)]
    assert (np.abs(found - median) < 1e-3).mean() > 0.8
    assert (errors[0] - errors[1]).max() < 2.0 * DRAW


def test_a_draw_is_answered_in_between():
    candidates = torch.tensor([0.2, 0.8]).reshape(1, 2, 1, 1)
    zero = torch.zeros((1, 1, 1, 1))
    answer = RefinePrediction(candidates, torch.zeros((1, 2, 1, 1)), zero, zero, zero)
    assert float(answer.root()) == pytest.approx(0.5)


def test_inverse_depth_is_never_negative_and_zero_is_reached():
    zero = torch.zeros((1, 1, 1, 1))
    candidates = torch.zeros((1, CANDIDATES, 1, 1))
    answer = RefinePrediction(candidates, candidates, zero - 0.2, zero, zero)
    assert float(answer.root()) < 0.0
    assert float(answer.inverse_depth()) == 0.0


def test_single_precision_is_enough(network):
    """float32 against float64, relative to the inverse depth."""
    given = random_planes()
    with torch.no_grad():
        single = network(given)
        double = RefineNetwork(REFINE).double()
        double.load_state_dict(network.state_dict())
        exact = double.eval()(given.double())
    same_choice = (single.root() - exact.root()).abs() < 0.01
    assert same_choice.float().mean() > 0.999
    error = (single.inverse_depth().double() - exact.inverse_depth()).abs()[same_choice]
    assert np.quantile(error / exact.inverse_depth()[same_choice].clamp(min=1e-3), 0.999) < 1e-3
