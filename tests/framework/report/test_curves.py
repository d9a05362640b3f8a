"""Metrics against a swept value and over time: the numbers are the board's, and the pictures show them."""

from __future__ import annotations

import math
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from click.testing import CliRunner
from harness_study import write_study

from sonobench.board import leaderboard
from sonobench.cli.app import app
from sonobench.errors import InputError
from sonobench.log import read_estimates
from sonobench.registry import Registry
from sonobench.report import curve, over_time
from sonobench.report.curve_figures import curve_figure, time_figure
from sonobench.report.recordings import Recordings
from sonobench.report.style import MOST, curve_style, named, scaled
from sonobench.scene import Scene, Study
from sonobench.scoring import aligned

P_D, SPREAD = "p_scene.simulator.p_d", "p_pipelines.guesser.tracker.spread_m"
STUDY = """
plugins = ["plugin.py"]
scenes = ["one.toml", "two.toml"]
repetitions = 6
metrics = ["gospa", "cardinality", "position-error", "distance"]
reference = ["paper.toml"]
[pipelines]
guesser = {}
raise = {}
[sweep]
scene.simulator.p_d = [0.05, 0.9]
pipelines.guesser.tracker.spread_m = [0.02, 0.5]
"""
PAPER = """
citation = "Somebody 1999"
[[tables]]
table = "Table 1"
metric = "gospa"
unit = "m"
at.scene.simulator.p_d = [0.05, 0.9]
values = { raise = [0.25, 0.75] }
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("curves")
    path = write_study(folder, STUDY)
    (folder / "paper.toml").write_text(PAPER)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
        yield Study.load(path).run(out=folder / "run", in_process=True)


def test_a_curve_over_a_swept_value_has_the_boards_own_means_and_intervals(run):
    table = run.curve("p_d", ["gospa", "position-error"])
    for metric, mine in table.groupby("metric"):
        board = run.board(metric, by="p_d")
        for name in (P_D, "mean", "low", "high", "interval", "failures", "ref.paper"):
            np.testing.assert_array_equal(mine[name], board[name])
        np.testing.assert_array_equal(mine["entry"], board["pipeline"])
        assert list(mine["pipeline"]) == list(mine["entry"])
    assert set(zip(table["n"], table["over"], strict=True)) == {(2, "scenarios"), (0, "")}  # two scenes; a failure has no position error
    one = run.where(scenes=["one"]).curve("p_d", ["gospa"])
    assert set(zip(one["n"], one["over"], strict=True)) == {(6, "repetitions")}
    assert not np.array_equal(one["mean"], table["mean"][: len(one)])


def test_a_parameter_of_a_pipeline_makes_one_curve_of_its_entries_and_what_it_does_not_touch_is_level(run):
    table = run.curve("spread_m")
    assert sorted(set(table["pipeline"])) == ["guesser", "raise"]
    assert sorted(table.loc[table["pipeline"] == "guesser", "entry"]) == ["guesser[spread_m=0.02]", "guesser[spread_m=0.5]"]
    assert list(table.loc[table["pipeline"] == "raise", SPREAD]) == [0.02, 0.5]
    assert table.loc[table["pipeline"] == "raise", "mean"].nunique() == 1
    assert table.attrs["pooled"] == {P_D: [0.05, 0.9]}


def test_a_frames_mean_and_interval_are_what_a_board_of_that_frame_alone_says(run):
    part = run.where(scenes=["one"], at={"p_d": [0.9]})
    table = part.curve("time", ["gospa"])
    assert (table["n"] == 6).all()
    frame = table[(table["metric"] == "gospa") & np.isclose(table["time_s"], 0.5)].set_index("pipeline")
    recordings, scores = Recordings(part), []
    for row in part.trials.sort_values("recording_key").to_dict("records"):
        states, space = [], None
        if row["status"] == "ok":
            states, space, _ = read_estimates(run.path / row["estimates_path"])
        at = aligned(recordings.of(row).truth, states, space).frames[4]
        d = [math.dist(at.truth[0][:2], e) for e in at.estimates]
        gospa = d[0] if d and d[0] < 1 else math.sqrt(0.5 + 0.5 * len(d))  # one target, at most one estimate, c = 1
        scores.append({"trial_key": row["trial_key"], "metric": "gospa", "slice": "", "value": gospa, "weight": 1.0, "coverage": 1.0})
    common = {"unit": "m", "better": "lower", "pool": "mean", "metric_sha": "m"}
    board = leaderboard(part.trials, pd.DataFrame(scores).assign(**common), "gospa").set_index("pipeline")
    for name in ("mean", "low", "high"):
        np.testing.assert_allclose(frame[name], board.loc[frame.index, name], rtol=1e-12)


def test_the_mean_over_frames_is_the_boards_mean_of_the_scenario_and_failures_count_as_empty(run):
    table = run.curve("time", ["gospa", "cardinality.are", "position-error.coverage"])
    for metric in ("gospa", "cardinality.are", "position-error.coverage"):
        means = table[table["metric"] == metric].groupby(["scene", P_D, "pipeline"])["mean"].mean()
        for (scene, p_d), own in means.groupby(level=[0, 1]):
            board = run.where(scenes=[scene], at={"p_d": [p_d]}).board(metric).set_index("pipeline")["mean"]
            np.testing.assert_allclose(own.droplevel([0, 1]), board.loc[own.index.get_level_values(2)], rtol=1e-12)
    number = table[table["metric"] == "number"]
    assert (number["targets"] == 1).all()
    assert (number.loc[number["pipeline"] == "raise", "mean"] == 0).all()
    assert (number.loc[number["pipeline"] != "raise", "mean"] == 1).all()


@pytest.mark.parametrize("metric", ["distance", "position-error", "position-error.median"])
def test_metrics_without_a_value_of_each_frames_own_are_refused_and_those_with_one_named(run, metric):
    with pytest.raises(
        InputError, match=rf"^{metric} has no value of its own at each evaluation time.*: gospa, gospa.localisation, .*false"
    ):
        run.curve("time", [metric])


def test_estimates_that_do_not_give_the_stored_score_are_not_drawn(run):
    forged = SimpleNamespace(**{n: getattr(run, n) for n in ("path", "paths", "metrics", "studies", "registry", "trials")})
    forged.scores = run.scores.assign(value=run.scores["value"] + 1e-3)
    with pytest.raises(InputError, match=r"gospa is not what is stored when it is computed again"):
        over_time(forged, ["gospa"])


def test_wrong_names_are_refused_with_what_there_is(run):
    for wrong, said in (("p_dd", "did you mean 'p_d'"), ("snr_db", "it has .*spread_m")):
        with pytest.raises(InputError, match=f"no such swept column.*{said}"):
            run.curve(wrong)
    with pytest.raises(InputError, match="did you mean 'gospa'"):
        run.curve("p_d", ["gosp"])
    with pytest.raises(InputError, match=r"p_d is nowhere 0\.7; there is \[0\.05, 0\.9\]"):
        run.where(at={"p_d": ["0.7"]})
    with pytest.raises(InputError, match=r"no scene 'on', but .*did you mean 'one'"):
        run.where(scenes=["on"])
    with pytest.raises(InputError, match="sweeps nothing"):
        curve(SimpleNamespace(trials=run.trials.drop(columns=[P_D, SPREAD])), "p_d")
    for wrong in ({"over": "p_d", "trials": ["a"]}, {"metric": ["gospa", "ospa"]}, {"over": "time", "references": ["paper.toml"]}):
        with pytest.raises(InputError, match=r"--over|over time"):
            run.report(**wrong)


def test_the_figure_over_a_value_shows_means_intervals_printed_values_and_names_its_axes(run):
    table = run.where(scenes=["one"], pipelines=["raise", "guesser*"]).curve("p_d", ["gospa", "cardinality.are"])
    top, bottom = curve_figure(table, "t").axes
    assert (top.get_ylabel(), bottom.get_ylabel()) == ("gospa ↓ (m)", "cardinality.are ↓")
    assert (bottom.get_xlabel(), top.get_xscale()) == ("p_d", "log")
    assert [t.get_text() for t in bottom.get_xticklabels()] == ["0.05", "0.9"]
    assert [t.get_text() for t in top.get_legend().get_texts()] == [*sorted(set(table["pipeline"])), "hollow: printed (paper)"]
    for container in top.containers:
        own = table[(table["metric"] == "gospa") & (table["pipeline"] == container.get_label())]
        line, _, (bars,) = container
        np.testing.assert_array_equal(line.get_xydata(), own[[P_D, "mean"]])
        np.testing.assert_allclose([s[:, 1] for s in bars.get_segments()], own[["low", "high"]], rtol=1e-12)
        assert top.get_ylim()[0] <= own["low"].min() <= own["high"].max() <= top.get_ylim()[1]
    hollow = [line.get_ydata() for line in top.lines if line.get_markerfacecolor() == "none" and len(line.get_ydata())]
    assert [0.25, 0.75] in [list(y) for y in hollow]


def test_the_figure_over_time_shows_truth_as_steps_and_each_pipelines_mean_in_its_band(run):
    table = run.where(scenes=["two"], at={"p_d": [0.9]}).curve("time", ["gospa"])
    top, bottom = time_figure(table, ["gospa"], "t").axes
    assert (top.get_ylabel(), bottom.get_ylabel(), bottom.get_xlabel()) == ("gospa (m)", "number of targets", "time (s)")
    truth = bottom.lines[0]
    assert (truth.get_label(), truth.get_drawstyle(), set(truth.get_ydata())) == ("truth", "steps-post", {1.0})
    for line, band in zip(top.lines, top.collections, strict=True):
        own = table[(table["metric"] == "gospa") & (table["pipeline"] == line.get_label())]
        np.testing.assert_array_equal(line.get_xydata(), own[["time_s", "mean"]])
        np.testing.assert_allclose(band.get_paths()[0].vertices[:, 1].max(), own["high"].max())
    assert len({(line.get_color(), line.get_marker(), line.get_linestyle()) for line in top.lines}) == 3


def test_the_best_of_more_curves_than_can_be_told_apart_are_drawn_and_that_is_said(run):
    base = run.where(pipelines=["raise"]).curve("p_d")
    many = pd.concat([base.assign(pipeline=f"p{k:02d}", mean=base["mean"] - k) for k in range(MOST + 3)], ignore_index=True)
    many.attrs = base.attrs
    figure = curve_figure(many, "t")
    assert [c.get_label() for c in figure.axes[0].containers] == [f"p{k:02d}" for k in range(3, MOST + 3)]
    assert f"the {MOST} best of {MOST + 3} pipelines are drawn" in " ".join(figure.get_supxlabel().split())
    assert len({curve_style(k)[0] for k in range(MOST)}) == len({curve_style(k)[1] for k in range(MOST)}) == MOST


def test_the_command_writes_each_picture_with_its_numbers_beside_it(run, tmp_path):
    words = ["report", str(run.path), "-o", str(tmp_path / "out"), "--scene", "one", "--metric", "gospa"]
    done = CliRunner().invoke(app, [*words, "--over", "p_d", "--pipeline", "raise"], catch_exceptions=False, standalone_mode=False)
    assert done.output.split() == [str(tmp_path / "out" / f"over-p_d-gospa.{end}") for end in ("png", "csv")]
    part = run.where(["one"], pipelines=["raise"])
    back = pd.read_csv(tmp_path / "out" / "over-p_d-gospa.csv", keep_default_na=False)
    np.testing.assert_array_equal(back[["mean", "low", "high"]].astype(float), part.curve("p_d", ["gospa"])[["mean", "low", "high"]])
    done = CliRunner().invoke(app, [*words, "--over", "time", "--at", "p_d=0.9"], catch_exceptions=False, standalone_mode=False)
    names = [f"time-gospa-one_p_d=0.9.{end}" for end in ("png", "csv")]
    assert done.output.split() == [str(tmp_path / "out" / name) for name in names]
    assert (tmp_path / "out" / names[0]).read_bytes()[:4] == b"\x89PNG"
    back = pd.read_csv(tmp_path / "out" / names[1])
    assert list(back.columns) == ["scene", P_D, "metric", "unit", "time_s", "pipeline", "n", "mean", "low", "high", "targets"]
    assert len(back) == 2 * 3 * 10


def test_metrics_can_be_named_by_patterns_and_files_are_called_without_settings(run):
    from sonobench.report.metric_report import _words
    from sonobench.report.selection import metrics_of

    assert metrics_of(run, ["gospa*e*", "cardinality"]) == ["gospa.false", "gospa.missed", "cardinality"]
    with pytest.raises(InputError, match=r"no metric of the run matches 'x\*'; it has .*'gospa'"):
        run.curve("p_d", ["x*"])
    several = SimpleNamespace(metrics=("ospa[c_m=1.5,p=2.0]", "ospa[c_m=1.0]", "gospa[c_m=1.0]"))
    assert _words(several, ["ospa[c_m=1.0].localisation", "gospa[c_m=1.0]"]) == "ospa-2.localisation+gospa"


def test_over_time_every_scenario_has_a_picture_up_to_a_dozen(run, tmp_path):
    part = run.where(at={"p_d": [0.9]}, pipelines=["raise", "*0.5]"])
    assert len(part.report(over="time", out=tmp_path)) == 2 * 2
    many = run.where()
    many.__dict__["_tables"] = (run.trials.assign(**{P_D: np.arange(len(run.trials))}), run.scores)
    with pytest.raises(InputError, match=r"72 scenarios.*--scene NAME and --at COLUMN=VALUE"):
        many.report(over="time", out=tmp_path)


def test_a_scene_is_drawn_without_a_run(tmp_path):
    from sonobench.report.scene_report import _laid_out

    done = CliRunner().invoke(
        app, ["data", "draw", "chen2012", "-o", str(tmp_path / "s.png")], catch_exceptions=False, standalone_mode=False
    )
    assert done.output.strip() == str(tmp_path / "s.png")
    assert (tmp_path / "s.png").read_bytes()[:4] == b"\x89PNG"
    header, truth = _laid_out(Scene.load("chen2012", Registry.load()))
    rendering = Scene.load("chen2012", Registry.load()).simulate(0)
    np.testing.assert_array_equal(truth.position, rendering.truth.position)
    np.testing.assert_array_equal(header.box_m, rendering.header.box_m)


def test_parameters_are_named_with_their_units_and_small_times_in_units_that_can_be_read():
    names = ("delay_std_s", "snr_db", "p_d", "clutter_per_scan", "speed_m_s", "t60_s")
    assert [named(n) for n in names] == [
        ("delay std", "s"), ("snr", "dB"), ("p_d", ""), ("clutter per scan", ""), ("speed", "m/s"), ("t60", "s"),
    ]  # fmt: skip
    assert scaled("s", [55e-6, 125e-6]) == (1e6, "µs")
    assert scaled("s", [0.016, 0.032]) == (1e3, "ms")
    assert scaled("s", [0.2, 2.0]) == (1.0, "s")
    assert scaled("Hz", [1e-6]) == (1.0, "Hz")


def test_a_root_is_taken_over_recordings_at_each_frame_and_undefined_values_weigh_nothing():
    from sonobench.board.rows import coded
    from sonobench.report.time_curves import _Frames, _pooled

    trials = pd.DataFrame({"pipeline": ["a"] * 3, "scene": "s", "repetition": range(3), "run": 0, "status": "ok"})
    values = np.array([[3.0, 1.0], [4.0, np.nan], [5.0, 7.0]])
    weights = np.array([[1.0, 1.0], [1.0, 0.0], [2.0, 1.0]])
    table = _pooled("m", _Frames(values, weights, "m", "frame-rms"), coded(trials), np.array([0.1, 0.2]))
    np.testing.assert_allclose(table["mean"], [math.sqrt((9 + 16 + 2 * 25) / 4), 5.0], rtol=1e-12)
    assert list(table["n"]) == [3, 2]
    assert (table["low"] < table["mean"]).all()
