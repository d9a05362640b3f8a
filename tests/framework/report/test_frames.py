"""Pictures of single frames: what stands where, and what they are made of."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from sonobench import Registry, Study
from sonobench.errors import InputError
from sonobench.geometry import sensor_delays
from sonobench.report.frame_report import frame_figure, modes_of
from sonobench.testing import fixtures
from sonobench.types import DelayTable, Detections, Scan, Space

SETUP, TRUTH = fixtures.setup("pairs"), fixtures.truth(6)
VALUES = np.random.default_rng(0).random((4, 201)).astype(np.float32)
TABLE = DelayTable(VALUES, -1e-3, 1e-5)


def scan(k: int = 2, score: list[float] | None = None) -> Scan:
    rows = Detections(np.array([[1e-4], [-3e-4], [2e-4]]), np.array([0, 0, 2]), score=score)
    return Scan(float(TRUTH.time_s[k]), np.array([True, True, True, False]), (rows,), {"gcc": TABLE})


def lines(axes, style):
    return [line for line in axes.lines if line.get_linestyle() == style and len(line.get_xdata()) == 2]


def test_a_frame_shows_each_pairs_correlation_its_rows_and_where_the_sources_are():
    modes = {q: {7: np.array([1e-4, 5e-4, -6e-4]), 9: np.array([-2e-4])} for q in (0, 2, 3)}
    panels = frame_figure(scan(score=[0.9, 0.4, 0.7]), SETUP, modes).axes
    assert [axes.get_ylabel() for axes in panels] == [*(SETUP.sensors[q].name for q in (0, 2)), f"{SETUP.sensors[3].name}, not searched"]
    np.testing.assert_allclose(panels[1].lines[0].get_ydata(), VALUES[2])
    assert [line.get_xdata()[0] for line in lines(panels[0], "-")] == pytest.approx([0.1, -0.2])  # ms
    assert [line.get_xdata()[0] for line in lines(panels[0], "--")] == pytest.approx([0.5, -0.6])
    rows = next(line for line in panels[0].lines if line.get_marker() == "o")
    np.testing.assert_allclose(rows.get_xydata(), [[0.1, 0.9], [-0.3, 0.4]])
    words = [text.get_text() for text in panels[0].get_legend().get_texts()]
    assert words == ["correlation", "target 7", "target 7, echoes", "target 9", "picked"]


def test_rows_without_scores_stand_on_the_curve():
    rows = next(line for line in frame_figure(scan(), SETUP, {0: {}}).axes[0].lines if line.get_marker() == "o")
    np.testing.assert_allclose(rows.get_ydata(), VALUES[0, [110, 70]], rtol=1e-4)


def test_delays_are_those_of_the_trackers_modes_and_without_a_model_the_direct_ones():
    expected = sensor_delays(TRUTH.position[2], SETUP, 1)
    direct = modes_of(None, TRUTH, SETUP, scan(), 1)
    assert list(direct) == TRUTH.label[TRUTH.active[2]].tolist()
    np.testing.assert_allclose(list(direct.values()), expected[TRUTH.active[2]])

    space = Space(("x_m", "vx_m_s", "y_m", "vy_m_s"))
    bound = SimpleNamespace(sensors=(1,), h=lambda x, q: x[:, None, [0]] + np.array([0.0, 10.0])[:, None])
    tracker = SimpleNamespace(space=space, measurement=SimpleNamespace(bind=lambda s, told: bound))
    own = modes_of(tracker, TRUTH, SETUP, scan(), 1)
    x = TRUTH.position[2, TRUTH.active[2], 0]
    np.testing.assert_allclose(list(own.values()), np.stack([x, x + 10], axis=1))
    np.testing.assert_allclose(
        list(modes_of(tracker, TRUTH, SETUP, scan(), 0).values()), list(modes_of(None, TRUTH, SETUP, scan(), 0).values())
    )


def test_frames_of_a_run_are_drawn_also_where_a_pipeline_ends_at_its_scans(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    golden = Registry.load().find_data("recordings", "golden", ".mcap")
    (tmp_path / "s.toml").write_text(
        f'recordings = ["{golden}"]\nmetrics = ["delay-error"]\n[pipelines.peaks]\nuse = "pipeline"\nfront_end = "gcc-peaks"\n'
    )
    run = Study.load(tmp_path / "s.toml").run(out=tmp_path / "run", in_process=True)
    assert run.failed == 0
    (key,) = run.trials["trial_key"]
    first, second = run.report(frames_s=[0.5, 99.0])
    assert first.name.startswith("peaks_golden_rep_0_")
    assert first.read_bytes() != second.read_bytes()
    assert run.report(frames_s=[0.5], trials=[key[:6]], out=tmp_path / "again")[0].read_bytes() == first.read_bytes()
    with pytest.raises(InputError, match="leave --over"):
        run.report(frames_s=[0.5], over="time")
    with pytest.raises(InputError, match="--trial zz: 0 trials"):
        run.report(frames_s=[0.5], trials=["zz"])
