"""Direction spectra as evidence."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from vector_sources import heard, spread

from sonobench.errors import InputError, SetupError
from sonobench.geometry import angles
from sonobench.types import DelayTable, Detections, DirectionSpectrum, Scan, Sensor, Setup, Space
from sonobench_plugins.likelihood.direction_spectrum import SpectrumLikelihood
from sonobench_plugins.spectrum.cumulant import CumulantSpectrum

_SPACE = Space.of("elevation_rad", "azimuth_rad", "azimuth_rad_s")


def _setup(sensors: int = 1) -> Setup:
    made = [Sensor(f"avs-{k}", "avs", "direction", np.zeros((1, 3)), Space.of("azimuth_rad", "elevation_rad")) for k in range(sensors)]
    return Setup(tuple(made), ("avs",), np.eye(4)[None], nominal={"p_d": 0.9, "clutter_per_scan": 0.2})


def _scan(field: object, **more: object) -> Scan:
    return Scan(0.0, np.zeros(1, bool), fields={"spectrum": field}, **more)  # type: ignore[arg-type,dict-item]


def _states(u: np.ndarray) -> np.ndarray:
    z = angles(u)
    return np.column_stack([z[:, 1], z[:, 0], np.zeros(len(z))])


def _spectrum(m: int) -> tuple[DirectionSpectrum, np.ndarray]:
    rng = np.random.default_rng(m)
    u = spread(rng, m, 50)
    return CumulantSpectrum().fields(heard(rng, u)[None])[0], u


def test_who_is_there_gains_and_who_is_not_loses():
    field, u = _spectrum(3)
    bound = SpectrumLikelihood().bind(_SPACE, _setup())
    assert bound.log_ratio(_states(u), _scan(field)).min() > 3
    away = [v for v in np.random.default_rng(8).normal(size=(200, 3)) if (u @ v).max() < 0.7 * np.linalg.norm(v)]
    assert np.median(bound.log_ratio(_states(np.array(away)), _scan(field))) == pytest.approx(np.log(0.1), abs=0.1)


def test_the_mean_ratio_over_the_sphere_is_that_of_so_many_detections():
    field, _ = _spectrum(3)
    bound = SpectrumLikelihood().bind(_SPACE, _setup())
    k = np.arange(100_000) + 0.5
    u = np.stack([np.sqrt(1 - (1 - k / 5e4) ** 2) * f(np.pi * (1 + 5**0.5) * k) for f in (np.cos, np.sin)] + [1 - k / 5e4], axis=1)
    ratio = np.exp(bound.log_ratio(_states(u), _scan(field)))
    assert ratio.mean() == pytest.approx(0.1 + 0.9 * 3 / 0.2, rel=0.03)


def test_where_nothing_was_found_a_target_was_missed():
    field, _ = _spectrum(0)
    bound = SpectrumLikelihood().bind(_SPACE, _setup())
    np.testing.assert_allclose(bound.log_ratio(np.zeros((4, 3)), _scan(field)), np.log(0.1))
    assert bound.log_ratio(np.zeros((0, 3)), _scan(field)).shape == (0,)


def test_several_sensors_add_up_and_deaf_ones_say_nothing():
    field, u = _spectrum(2)
    two = DirectionSpectrum(*(np.repeat(getattr(field, n), 2, axis=0) for n in ("noise", "spread", "height", "power", "heard")))
    one = SpectrumLikelihood().bind(_SPACE, _setup()).log_ratio(_states(u), _scan(field))
    bound = SpectrumLikelihood().bind(_SPACE, _setup(2))
    np.testing.assert_allclose(bound.log_ratio(_states(u), _scan(two)), 2 * one)
    half = dataclasses.replace(two, heard=np.array([True, False]))
    np.testing.assert_allclose(bound.log_ratio(_states(u), _scan(half)), one)
    assert bound.log_ratio(_states(u), _scan(dataclasses.replace(two, heard=np.zeros(2, bool)))) is None


def test_without_a_spectrum_there_is_no_evidence_or_a_word_about_it():
    bound = SpectrumLikelihood().bind(_SPACE, _setup())
    assert bound.log_ratio(np.zeros((1, 3)), Scan(0.0, np.zeros(1, bool))) is None
    rows = (Detections(np.zeros((1, 2)), np.zeros(1, np.int64)),)
    with pytest.raises(InputError, match="front end avs"):
        bound.log_ratio(np.zeros((1, 3)), Scan(0.0, np.ones(1, bool), rows))
    named = Scan(0.0, np.ones(1, bool), fields={"spectrum": DelayTable(np.zeros((1, 3)), 0.0, 1.0)})
    with pytest.raises(InputError, match=r"'spectra'.*\['spectrum'\]"):
        SpectrumLikelihood(field="spectra").bind(_SPACE, _setup()).log_ratio(np.zeros((1, 3)), named)
    with pytest.raises(InputError, match="DelayTable"):
        bound.log_ratio(np.zeros((1, 3)), _scan(DelayTable(np.zeros((1, 3)), 0.0, 1.0)))


def test_setups_and_states_that_do_not_fit_are_refused():
    with pytest.raises(SetupError, match="azimuth_rad"):
        SpectrumLikelihood().bind(Space.of("x_m"), _setup())
    with pytest.raises(SetupError, match="direction"):
        SpectrumLikelihood().bind(_SPACE, Setup(()))
    with pytest.raises(SetupError, match="p_d"):
        SpectrumLikelihood().bind(_SPACE, dataclasses.replace(_setup(), nominal={}))
    with pytest.raises(ValueError, match="above 0"):
        SpectrumLikelihood(clutter_per_scan=0.0)


def test_spectra_of_another_shape_are_refused():
    with pytest.raises(ValueError, match="10, 10"):
        DirectionSpectrum(np.zeros((1, 9, 9)), np.zeros((1, 9, 9)), np.zeros(1), np.zeros(1), np.ones(1, bool))
