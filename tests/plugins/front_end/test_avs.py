"""The front end of vector sensors: one sensor an element, rows with covariance and score, fields, silence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from vector_snapshots import Z, snapshots

from sonobench import Block, DelayTable, DirectionSpectrum, Header, MicArray, PluginError, Scan, SetupError
from sonobench.protocols import Directions
from sonobench_plugins.direction.music import Music
from sonobench_plugins.direction.wpf_mp import WpfMp
from sonobench_plugins.front_end.avs import Avs
from sonobench_plugins.preprocessor.pre_filter import PreFilter

_RATE = 8000.0


def _header(*elements: int, kind: str = "avs") -> Header:
    arrays = tuple(MicArray(f"ear{i}", kind, np.zeros((n, 3)), _RATE) for i, n in enumerate(elements))
    return Header("take", arrays, np.tile(np.eye(4), (len(arrays), 1, 1)), duration_s=1.0)


def _run(front_end: Avs, header: Header, *samples: Any) -> list[Scan]:
    _, state = front_end.open(header)
    scans: list[Scan] = []
    for array, x in zip(header.arrays, samples, strict=True):
        state, ready = front_end.step(state, Block(array.name, 0, np.asarray(x, np.float32)))
        scans += ready
    return [*scans, *front_end.flush(state)]


def _second(z: Any = Z, seed: int = 0) -> Any:
    return snapshots(np.random.default_rng(seed), 1, 8000, z)[0]


def test_every_element_is_a_sensor_of_directions_with_rows_of_its_own() -> None:
    there = np.array([-2.0, -0.4])
    header = _header(2, 1)
    setup, _ = Avs().open(header)
    assert [(s.name, s.array, s.kind) for s in setup.sensors] == [
        ("direction-0", "ear0", "direction"),
        ("direction-1", "ear0", "direction"),
        ("direction-2", "ear1", "direction"),
    ]
    scans = _run(Avs(direction=WpfMp()), header, np.concatenate([_second(), _second(there)], axis=1), _second(there))
    assert len(scans) == 10
    assert setup.period_s == 0.1
    for scan in scans:
        assert scan.searched.all()
        assert not scan.fields
        for q, z in enumerate((Z, there, there)):
            row, R = scan.rows(q)
            assert R is not None
            assert R.shape == (1, 2, 2)
            step = row[0] - z
            assert step @ np.linalg.solve(R[0], step) < 25


def test_an_array_can_be_named_and_frames_stand_at_their_centres() -> None:
    scans = _run(replace(Avs(array="ear1"), frame_s=0.2), _header(1, 1), np.zeros((8000, 4)), _second())
    assert scans[0].time_s == pytest.approx(0.1 - 0.5 / _RATE)
    assert scans[0].searched.tolist() == [True]


def test_a_silent_sensor_is_not_searched_beside_one_that_hears() -> None:
    x = np.concatenate([_second(), np.zeros((8000, 4))], axis=1)
    x[:800] = 0.0
    scans = _run(Avs(), _header(2), x)
    assert scans[0].searched.tolist() == [False, False]
    assert scans[0].detections == ()
    assert scans[1].searched.tolist() == [True, False]
    assert scans[1].detections[0].sensor.tolist() == [0]


def test_rows_that_an_estimator_marks_invalid_are_no_rows() -> None:
    x = np.array(_second(), copy=True)
    x[:, 1:] = 0.0  # a sensor without velocities shows no direction
    scans = _run(Avs(direction=Music(sources=2)), _header(1), x)
    assert all(s.searched.all() and len(s.detections[0]) == 0 and s.detections[0].z.shape == (0, 2) for s in scans)


@dataclass(frozen=True)
class _Heights:
    """A spectrum whose height is the frame's power."""

    flat: bool = False

    def fields(self, samples: Any) -> Sequence[Any]:
        power = np.mean(samples**2, axis=(1, 2))
        unit = np.eye(4)[None]
        made = [DirectionSpectrum(unit, unit, np.array([h]), np.ones(1), np.ones(1, bool)) for h in power]
        return [DelayTable(np.zeros((1, 3)), 0.0, 1.0)] * len(made) if self.flat else made


def test_spectra_of_several_sensors_are_one_field_in_which_the_silent_say_nothing() -> None:
    x = np.concatenate([_second(), np.zeros((8000, 4)), 2 * _second()], axis=1)
    scans = _run(Avs(spectrum=_Heights()), _header(3), x)
    field: Any = scans[3].fields["spectrum"]
    assert field.heard.tolist() == [True, False, True]
    assert field.height[2] == pytest.approx(4 * field.height[0], rel=1e-5)
    assert not scans[3].searched.any()
    assert scans[3].detections == ()
    both = _run(Avs(direction=WpfMp(), spectrum=_Heights()), _header(3), x)[3]
    assert both.searched.tolist() == [True, False, True]
    assert "spectrum" in both.fields
    silent = _run(Avs(spectrum=_Heights()), _header(1), np.zeros((8000, 4)))
    assert all(not s.fields for s in silent)
    with pytest.raises(PluginError, match="array of one element"):
        _run(Avs(spectrum=_Heights(flat=True)), _header(3), x)


def test_preprocessing_keeps_the_direction_and_the_times() -> None:
    plain, filtered = (_run(Avs(preprocess=chain), _header(1), _second()) for chain in ((), (PreFilter(low_hz=300.0, high_hz=3000.0),)))
    assert [s.time_s for s in filtered] == [s.time_s for s in plain]
    last = np.mean([s.rows(0)[0][0] for s in filtered[2:]], axis=0)
    assert np.allclose(last, Z, atol=0.05)


def test_recordings_that_it_cannot_read_are_refused_by_name() -> None:
    with pytest.raises(SetupError, match=r"vector sensors.*take has 'ear0' of kind 'microphones'"):
        Avs().open(_header(4, kind="microphones"))
    with pytest.raises(SetupError, match="array 'nose'"):
        Avs(array="nose").open(_header(1))
    two = replace(_header(1, 1), arrays=(MicArray("a", "avs", np.zeros((1, 3)), 8000.0), MicArray("b", "avs", np.zeros((1, 3)), 16000.0)))
    with pytest.raises(SetupError, match="one rate"):
        Avs().open(replace(two, array_names=("a", "b")))


def test_an_estimator_of_wrong_shapes_is_named() -> None:
    @dataclass(frozen=True)
    class Flat:
        def directions(self, samples: Any) -> Directions:
            return Directions(np.zeros((len(samples), 3)), np.ones(len(samples), bool))

    with pytest.raises(PluginError, match="direction estimator Flat"):
        _run(Avs(direction=Flat()), _header(1), _second())


_X = np.array([1.0, 0.0, 0.0])


@pytest.mark.parametrize(
    ("made", "words"),
    [
        (lambda f: np.zeros((f, 1, 3)), "gave a ndarray.*Directions"),
        (lambda f: Directions(np.tile(3 * _X, (f, 1, 1)), np.ones((f, 1), bool)), "length 3; unit vectors"),
        (lambda f: Directions(np.full((f, 1, 3), np.nan), np.ones((f, 1), bool)), "length nan; unit vectors"),
        (lambda f: Directions(np.tile(_X, (f, 1, 1)), np.ones((f, 1), bool), np.tile(-np.eye(2), (f, 1, 1, 1))), "no covariance"),
        (lambda f: Directions(np.tile(_X, (f, 1, 1)), np.ones((f, 1), bool), np.full((f, 1, 2, 2), np.nan)), "no covariance"),
    ],
)
def test_an_estimator_of_wrong_values_is_named(made: Any, words: str) -> None:
    @dataclass(frozen=True)
    class Wrong:
        def directions(self, samples: Any) -> Any:
            return made(len(samples))

    with pytest.raises(PluginError, match=f"direction estimator Wrong.*{words}"):
        _run(Avs(direction=Wrong()), _header(1), _second())


def test_directions_marked_invalid_may_have_any_length_and_covariance() -> None:
    @dataclass(frozen=True)
    class Unsure:
        def directions(self, samples: Any) -> Directions:
            f = len(samples)
            return Directions(np.zeros((f, 1, 3)), np.zeros((f, 1), bool), np.full((f, 1, 2, 2), np.nan))

    assert all(len(s.rows(0)[0]) == 0 for s in _run(Avs(direction=Unsure()), _header(1), _second()))


def test_a_spectrum_that_gives_no_fields_is_named() -> None:
    @dataclass(frozen=True)
    class Bare:
        def fields(self, samples: Any) -> Any:
            return [np.zeros(3) for _ in samples]

    with pytest.raises(PluginError, match=r"spectrum Bare gave a ndarray.*at\(z, sensor\)"):
        _run(Avs(spectrum=Bare()), _header(1), _second())
