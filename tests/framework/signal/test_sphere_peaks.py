import numpy as np
import pytest

from sonobench.signal.sphere_peaks import field_peaks
from sonobench.sphere import apart


class Humps:
    """Gaussian humps of arcs: centres (k, 2), deviations (k,) rad, heights (k,)."""

    unit = "1"

    def __init__(self, z, std, height):
        self.z, self.std, self.height = np.array(z, float).reshape(-1, 2), np.array(std), np.array(height)

    def at(self, z, sensor):
        off = apart(np.asarray(z)[..., None, :], self.z)
        return np.sum(self.height * np.exp(-0.5 * np.sum(off**2, axis=-1) / self.std**2), axis=-1)


@pytest.mark.parametrize("elevation", [0.0, 0.7, 1.5, np.pi / 2])
def test_places_heights_and_widths_of_separate_peaks(elevation):
    z = [[0.3, elevation], [np.pi - 0.01, -0.5], [-2.0, 0.1]]
    field = Humps(z, [0.03, 0.1, 0.05], [1.0, 3.0, 0.5])
    found = field_peaks(field, 0, 0.1, 8)
    assert len(found.z) == 3
    np.testing.assert_allclose(np.linalg.norm(apart(found.z, np.array(z)[[1, 0, 2]]), axis=1), 0, atol=1e-4)
    np.testing.assert_allclose(found.height, [3.0, 1.0, 0.5], rtol=1e-3)
    np.testing.assert_allclose(found.R, np.array([0.01, 0.0009, 0.0025])[:, None, None] * np.eye(2), rtol=0.03, atol=2e-5)


def test_low_peaks_and_too_many_are_left_out():
    field = Humps([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]], [0.05] * 3, [1.0, 0.6, 0.2])
    assert len(field_peaks(field, 0, 0.3, 8).z) == 2
    assert len(field_peaks(field, 0, 0.1, 1).z) == 1


def test_a_field_of_nothing_has_no_peaks():
    found = field_peaks(Humps(np.zeros((0, 2)), np.zeros(0), np.zeros(0)), 0, 0.1, 8)
    assert [a.shape for a in found] == [(0, 2), (0,), (0, 2, 2)]


def test_a_ridge_is_one_peak_however_many_starts_climb_it():
    from sonobench.geometry import unit_vector
    from sonobench.signal.sphere_peaks import field_peaks

    class Ridge:
        unit = "1"

        def __init__(self, centre):
            self.centre = centre

        def at(self, z, sensor):
            z = np.asarray(z)
            off = np.stack([np.angle(np.exp(1j * (z[..., 0] - self.centre[0]))) * np.cos(self.centre[1]), z[..., 1] - self.centre[1]], -1)
            return np.exp(-0.5 * ((off[..., 0] / 0.2) ** 2 + (off[..., 1] / 0.012) ** 2))

    rng = np.random.default_rng(0)
    for _ in range(12):
        centre = np.array([rng.uniform(-3, 3), rng.uniform(-0.5, 0.5)])
        found = field_peaks(Ridge(centre), 0, 0.3, 8)
        near = np.linalg.norm(unit_vector(found.z)[:, None] - unit_vector(found.z), axis=-1)
        assert (near[~np.eye(len(near), dtype=bool)] > 1e-3).all()
