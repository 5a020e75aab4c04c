import pytest
from stereo_samples import SIZE

from omnisyn_cli.stereo.matching_estimator import MatchingDepthEstimator, MatchingOptions


@pytest.fixture(scope="session")
def estimator() -> MatchingDepthEstimator:
    return MatchingDepthEstimator(MatchingOptions(size=SIZE))
