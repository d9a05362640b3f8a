import numpy as np

from sonobench.testing import fixtures
from sonobench_plugins.likelihood.direction_spectrum import SpectrumLikelihood
from sonobench_plugins.likelihood.fitted_detection import FittedDetection


def test_nothing_changes_at_the_highest_peak_and_the_floor_holds_between_peaks():
    setup, space = fixtures.setup("directions"), fixtures.SPACES[-1]
    scan = fixtures.scans(setup, fixtures.regular(1), clutter=0)[0]
    talkers = fixtures.measured_of(fixtures.talkers(np.array([0.1]))[0], setup.sensors[0], 343.0)
    x = np.zeros((3, 4))
    x[:2, ::2], x[2, ::2] = talkers, [-1.5, -0.8]
    inner = SpectrumLikelihood().bind(space, setup).log_ratio(x, scan)
    fitted = FittedDetection(floor=0.02).bind(space, setup).log_ratio(x, scan)
    share = scan.fields["spectrum"].at(talkers[:, None, :], np.array([0]))[:, 0]
    np.testing.assert_allclose(fitted - inner, [*np.log(share / share.max()), np.log(0.02)], atol=2e-3)
