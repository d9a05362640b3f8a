"""Pictures of a trial: what is drawn, and that nothing global is touched."""

from __future__ import annotations

import subprocess
import sys

import matplotlib as mpl
import numpy as np
import pytest
from scoring_scenes import XY, estimates, truth

from sonobench.report import figures, pictures
from sonobench.types import Estimate, Header, MicArray, Space

MICS = MicArray("table", "microphones", [[0.1, 0, 0], [-0.1, 0, 0]], 16000)
POSE = np.eye(4)
POSE[:3, 3] = (2, 1, 1)
HEADER = Header(name="h", arrays=(MICS,), poses=POSE[None], duration_s=4.0, box_m=[[0, 0, 0], [4, 3, 3]])
SCENE = truth([[[1, 1], [3, 2]]] * 4, exists=[[1, 0], [1, 1], [1, 1], [1, 1]], active=[[1, 0], [1, 0], [0, 1], [1, 1]])
OUTPUT = [Estimate(0.0, [[1.1, 1.0]], count=1.2), Estimate(1.0, np.zeros((0, 2)), count=0.1), Estimate(2.0, [[3, 2], [9, 9]], count=2.0)]


def size(path):
    data = path.read_bytes()
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    return int.from_bytes(data[16:20], "big"), int.from_bytes(data[20:24], "big")


def legend(axes):
    return [text.get_text() for text in axes.get_legend().get_texts()]


def test_a_trial_has_three_pictures_named_after_it_with_the_same_bytes_each_time_and_nothing_global_touched(tmp_path):
    before = dict(mpl.rcParams)
    paths = pictures(tmp_path, "mine[floor=0.05] best/room 1", HEADER, SCENE, OUTPUT, XY)
    assert [p.name for p in paths] == [f"mine_floor=0.05_best_room_1-{kind}.png" for kind in ("room", "coordinates", "count")]
    assert all(min(size(p)) > 300 for p in paths)
    assert {p.name for p in tmp_path.iterdir()} == {p.name for p in paths}
    first = [p.read_bytes() for p in paths]
    assert [p.read_bytes() for p in pictures(tmp_path, "mine[floor=0.05] best/room 1", HEADER, SCENE, OUTPUT, XY)] == first
    assert dict(mpl.rcParams) == before


def test_the_room_shows_walls_microphones_targets_and_how_many_estimates_lie_outside():
    axes = figures._room(HEADER, SCENE, OUTPUT, XY).axes[0]
    texts = legend(axes)
    assert {
        "wall",
        "begins",
        "ends",
        "path; thick: it sounds",
        "target 0",
        "target 1",
        "microphones",
        "estimates (1 outside the room)",
    } == set(texts)
    microphones = next(line for line in axes.lines if line.get_label() == "microphones")
    np.testing.assert_allclose(sorted(microphones.get_xdata()), [1.9, 2.1])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x (m)", "y (m)")
    assert axes.get_aspect() == 1.0


def test_truth_is_drawn_only_where_it_exists_and_wide_only_where_it_sounds():
    axes = figures._coordinates(HEADER, SCENE, OUTPUT, XY).axes[0]
    wide = next(line for line in axes.lines if line.get_label() == "target 1")
    np.testing.assert_array_equal(np.isnan(wide.get_ydata()), [True, True, False, False])
    dotted = axes.lines[list(axes.lines).index(wide) - 1]
    np.testing.assert_array_equal(np.isnan(dotted.get_ydata()), [True, False, False, False])


def test_the_count_shows_what_exists_sounds_is_reported_and_is_expected():
    axes = figures._count(HEADER, SCENE, OUTPUT, XY).axes[0]
    lines = {line.get_label(): list(line.get_ydata()) for line in axes.lines}
    assert lines == {"exist": [1, 2, 2, 2], "sound": [1, 1, 1, 2], "estimates": [1, 0, 2], "expected number": [1.2, 0.1, 2.0]}


def test_heights_have_a_panel_where_the_tracker_knows_them_and_directions_are_drawn_without_a_room(tmp_path):
    high = estimates([[[1, 1, 1.5]]])
    assert len(figures._coordinates(HEADER, SCENE, high, Space.of("x_m", "y_m", "z_m")).axes) == 3
    around = truth([[[1, 1]]] * 2, parameters={"origin_x_m": 0, "origin_y_m": 0, "origin_z_m": 0})
    space = Space.of("azimuth_rad", "elevation_rad")
    figure = figures._coordinates(HEADER, around, estimates([[[0.8, 0.1]]]), space)
    assert [axes.get_ylabel() for axes in figure.axes] == ["azimuth (rad)", "elevation (rad)"]
    assert len(pictures(tmp_path, "d", HEADER, around, estimates([[[0.8, 0.1]]]), space)) == 2


@pytest.mark.parametrize("output", [[], estimates([np.zeros((0, 2))])])
def test_an_output_without_anybody_and_a_recording_without_a_room_are_drawn(output):
    for draw in (figures._room, figures._coordinates, figures._count):
        assert "estimates" in legend(draw(Header(name="free field"), SCENE, output, XY).axes[0])


def test_matplotlib_is_imported_only_to_draw_and_pyplot_never():
    code = "import sys, sonobench.report.figures as f; assert not {'matplotlib', 'pandas'} & set(sys.modules); f.figure(1, 1)"
    subprocess.run([sys.executable, "-c", code + "; assert 'matplotlib.pyplot' not in sys.modules"], check=True)
