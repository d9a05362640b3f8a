"""What a board says of a run."""

from __future__ import annotations

import io
import json
import math

import numpy as np
import pandas as pd
import pytest
from board_runs import grid, run

from sonobench.board import leaderboard, render
from sonobench.errors import InputError

RNG = np.random.default_rng(2)
BASE = RNG.normal(0.4, 0.05, (8, 2))
GOOD = grid(lambda s, r: float(BASE[s, r]), 8, 2)
BAD = grid(lambda s, r: float(BASE[s, r]) + 0.2 + 0.01 * s, 8, 2)
EMPTY = grid(lambda s, r: 1.0, 8, 2)


def board(values, metric="ospa", **more):
    options = {k: more.pop(k) for k in ("by", "vs", "also") if k in more}
    return leaderboard(*run(values, metric, **more), metric, **options)


def row(table, pipeline):
    return table.set_index("pipeline").loc[pipeline]


def test_the_best_stands_first_and_separated_pipelines_have_letters_of_their_own():
    table = board({"bad": BAD, "good": GOOD, "nobody": EMPTY})
    assert table["pipeline"].tolist() == ["good", "bad", "nobody"]
    assert table["rank"].tolist() == [1, 2, 3]
    assert table["tie"].tolist() == ["a", "b", "c"]
    good = row(table, "good")
    assert good["mean"] == pytest.approx(BASE.mean())
    assert good["low"] < good["mean"] < good["high"]
    assert table.attrs["over"] == "scenarios"


def test_higher_is_better_where_the_metric_says_so():
    assert board({"bad": BAD, "good": GOOD}, better="higher")["pipeline"].tolist() == ["bad", "good"]


def test_repetitions_are_averaged_per_scene_so_more_of_them_do_not_narrow_the_interval():
    scenes = RNG.normal(0.4, 0.1, 8)
    once = row(board({"a": grid(lambda s, r: scenes[s], 8, 1)}), "a")
    often = row(board({"a": grid(lambda s, r: scenes[s] + (0.001 if r % 2 else -0.001), 8, 20)}), "a")
    assert often["high"] - often["low"] == pytest.approx(once["high"] - once["low"], rel=0.02)


def test_scenes_count_alike_however_many_repetitions_they_have():
    values = {("one", 0): 1.0, **{("two", r): 0.0 for r in range(9)}}
    assert row(board({"a": values}), "a")["mean"] == pytest.approx(0.5)


def test_within_one_scene_the_interval_is_over_repetitions_and_says_so():
    table = board({"a": grid(lambda s, r: RNG.normal(), 1, 8)})
    assert (table.attrs["over"], table.attrs["units"]) == ("repetitions", 8)
    assert "over 8 repetitions" in render(table)


def test_below_six_units_nothing_is_ranked_and_the_number_needed_is_said():
    table = board({"good": grid(lambda s, r: 0.1 + s / 10, 5, 2), "bad": grid(lambda s, r: 0.9, 5, 2)})
    assert table["pipeline"].tolist() == ["good", "bad"]
    assert table["rank"].isna().all()
    assert "too few scenarios to rank: 5; 6 are needed" in render(table)


def test_between_six_units_and_what_holm_needs_the_board_says_that_letters_cannot_separate():
    many = {f"p{k}": grid(lambda s, r, k=k: k + s / 10, 6, 1) for k in range(5)}
    table = board(many)
    assert set(table["tie"]) == {"a"}
    assert table["rank"].tolist() == [1, 2, 3, 4, 5]
    assert "10 are needed" not in render(board({k: many[k] for k in ("p0", "p1")}))
    assert "too few scenarios to separate anything among 10 comparisons: 6; 9 are needed" in render(table)


@pytest.mark.parametrize(
    ("pool", "pooled"),
    [
        ("mean", lambda v, w: (w * v).sum(1) / w.sum(1)),
        ("rate", lambda v, w: (w * v).sum(1) / w.sum(1)),
        ("rms", lambda v, w: np.sqrt((w * v**2).sum(1) / w.sum(1))),
        ("median", lambda v, w: v.mean(1)),
    ],
)
@pytest.mark.parametrize("scenes", [1, 7])
def test_trials_pool_over_repetitions_as_the_metric_says(pool, pooled, scenes):
    v, w = RNG.uniform(0.1, 1, (scenes, 6)), RNG.uniform(1, 5, (scenes, 6))
    table = board({"a": grid(lambda s, r: (v[s, r], w[s, r], 1.0), scenes, 6)}, pool=pool)
    assert row(table, "a")["mean"] == pytest.approx(pooled(v, w).mean())


@pytest.mark.parametrize("scenes", [1, 7])
def test_frame_rms_is_the_rms_over_runs_at_each_frame_then_the_mean_over_frames(scenes):
    v = RNG.uniform(0, 1, (scenes, 6, 4))
    table = board({"a": grid(lambda s, r: {str(k): float(v[s, r, k]) for k in range(4)}, scenes, 6)}, pool="frame-rms")
    assert row(table, "a")["mean"] == pytest.approx(np.sqrt((v**2).mean(axis=1)).mean())


def test_the_spread_of_pseudo_values_is_the_sampling_error_of_an_rms():
    draws = [np.sqrt((RNG.normal(size=40) ** 2).mean()) for _ in range(2000)]
    v = RNG.normal(size=(6, 40))
    widths = [np.subtract(*row(board({"a": grid(lambda s, r, x=x: abs(x[r]), 1, 40)}, pool="rms"), "a")[["high", "low"]]) for x in v]
    assert np.mean(widths) / (2 * 1.96) == pytest.approx(np.std(draws), rel=0.25)


def test_a_failed_pipeline_is_there_scored_as_empty_output():
    failed = [("broken", f"room{s}", r) for s in range(8) for r in range(2)]
    table = board({"good": GOOD, "broken": EMPTY}, failed=failed)
    found = row(table, "broken")
    assert (found["failures"], found["trials"], found["rank"], found["mean"]) == (16, 16, 2, 1.0)
    assert math.isnan(found["ms_per_frame"])
    assert row(table, "good")["ms_per_frame"] == pytest.approx(1.0)
    assert "16!" in render(table)
    assert "ranks unchanged if dropped (broken never succeeded)" in render(table)


def test_the_board_says_when_dropping_failures_changes_the_order():
    fallen = {k: (1.0 if k[0] == "room0" else v - 0.01) for k, v in GOOD.items()}
    table = board({"good": GOOD, "fragile": fallen}, failed=[("fragile", "room0", 0), ("fragile", "room0", 1)])
    assert table["pipeline"].tolist() == ["good", "fragile"]
    text = render(table)
    assert "order if dropped: fragile, good" in text


def test_a_metric_that_covers_a_share_does_not_rank_and_stands_at_the_end():
    partial = dict.fromkeys(GOOD, (0.01, 10.0, 0.8))
    lost = dict.fromkeys(GOOD, (math.nan, 0.0, 0.0))
    table = board({"lost": lost, "partial": partial, "good": GOOD, "bad": BAD})
    assert table["pipeline"].tolist() == ["good", "bad", "partial", "lost"]
    assert table["rank"].tolist()[:2] == [1, 2]
    assert table["rank"].isna().tolist() == [False, False, True, True]
    assert row(table, "partial")["mean"] == pytest.approx(0.01)
    assert row(table, "partial")["coverage"] == pytest.approx(0.8)
    assert " – lost" in render(table)


def test_only_complete_blocks_are_ranked_and_a_pipeline_without_scores_does_not_spoil_them():
    unscored = [("bad", "room3", 1), *(("absent", *k) for k in GOOD)]
    table = board({"good": GOOD, "bad": BAD, "absent": GOOD}, unscored=unscored, failed=unscored)
    kept = [v for k, v in GOOD.items() if k != ("room3", 1)]
    scenes = pd.Series(kept, index=[k[0] for k in GOOD if k != ("room3", 1)]).groupby(level=0).mean()
    assert row(table, "good")["mean"] == pytest.approx(scenes.mean())
    text = render(table)
    assert "ranked on 15 of 16 blocks" in text
    assert "no scores: absent" in text
    assert table["pipeline"].tolist()[-1] == "absent"


def test_a_scene_in_which_nothing_can_be_scored_costs_nobody_the_rank():
    empty = {("hall", 0): (math.nan, 0.0, 0.0)}
    table = board({"good": GOOD | empty, "bad": BAD | empty})
    assert table["rank"].tolist() == [1, 2]


def test_a_metric_that_is_undefined_everywhere_gives_a_board_without_ranks():
    nothing = dict.fromkeys(GOOD, (math.nan, 0.0, 0.0))
    table = board({"a": nothing, "b": nothing}, failed=[("b", "room0", 0)], vs="a")
    assert table["rank"].isna().all()
    assert table["mean"].isna().all()
    assert table["failures"].tolist() == [0, 1]
    assert "no complete block to rank" in render(table)
    assert json.loads(render(table, "json"))["rows"][0]["mean"] is None


def test_one_pipeline_alone_is_ranked_first():
    table = board({"good": GOOD})
    assert (table["rank"].tolist(), table["tie"].tolist()) == ([1], ["a"])


def test_differences_to_one_pipeline_are_paired():
    table = board({"good": GOOD, "bad": BAD}, vs="good")
    found = row(table, "bad")
    assert found["diff"] == pytest.approx(0.235)
    assert found["diff_low"] > 0.2
    assert found["diff_high"] - found["diff_low"] < 0.1 * (found["high"] - found["low"]) + 0.06
    assert found["diff_p"] == pytest.approx(2 / 2**8)
    assert math.isnan(row(table, "good")["diff"])
    assert "diff to good" in render(table)


def test_by_makes_one_board_a_value_and_any_unique_suffix_names_the_column():
    parts = [run({"good": GOOD, "bad": BAD}, **{"p_scene.noise.snr_db": snr}) for snr in (10, 20)]
    trials, scores = (
        pd.concat([p.assign(trial_key=p["trial_key"] + str(k)) for k, p in enumerate(side)]) for side in zip(*parts, strict=True)
    )
    for by in ("snr_db", "noise.snr_db", "p_scene.noise.snr_db"):
        table = leaderboard(trials, scores, "ospa", by=by)
        assert table["p_scene.noise.snr_db"].tolist() == [10, 10, 20, 20]
        assert table["rank"].tolist() == [1, 2, 1, 2]
    assert "scene.noise.snr_db = 20: ospa" in render(table)
    assert json.loads(render(table, "json"))["board"]["groups"][1]["value"] == 20
    merged = leaderboard(trials, scores, "ospa")
    assert (merged.attrs["units"], merged.attrs["over"], merged.attrs["repetitions"]) == (16, "scenarios", 2)
    assert "(scene.noise.snr_db): 16 of 8 scenes" in render(merged)
    assert "standard error of a difference is 1.5 times as large" in render(merged)  # √2 and the lost degree of freedom
    with pytest.raises(InputError, match=r"--by snr: no such column.*p_scene.noise.snr_db"):
        leaderboard(trials, scores, "ospa", by="snr")


def test_a_board_by_a_pipelines_parameter_keeps_the_pipelines_that_lack_it():
    column = "p_pipelines.mine.floor"
    parts = [run({"good": GOOD}, **{column: None}), run({"mine[floor=1]": BAD}, **{column: 1}), run({"mine[floor=2]": BAD}, **{column: 2})]
    trials, scores = (pd.concat(side) for side in zip(*parts, strict=True))
    table = leaderboard(trials, scores, "ospa", by="floor")
    assert table["pipeline"].tolist() == ["good", "mine[floor=1]", "good", "mine[floor=2]"]
    assert table.attrs["groups"][0]["units"] == 8


def test_other_metrics_can_stand_beside():
    trials, scores = run({"good": GOOD, "bad": BAD})
    table = leaderboard(trials, pd.concat([scores, scores.assign(metric="half", value=scores["value"] / 2)]), "ospa", also=["half"])
    np.testing.assert_allclose(table["half"], table["mean"] / 2)
    assert "half" in render(table).splitlines()[0]


def test_what_is_not_there_is_refused_with_what_is():
    with pytest.raises(InputError, match=r"'gospa'.*\['ospa'\]"):
        leaderboard(*run({"good": GOOD}), "gospa")
    with pytest.raises(InputError, match=r"'glmb'.*\['good'\]"):
        board({"good": GOOD}, vs="glmb")
    trials, scores = run({"good": GOOD})
    scores.loc[0, "metric_sha"] = "other"
    with pytest.raises(InputError, match="2 different settings"):
        leaderboard(trials, scores, "ospa")
    with pytest.raises(InputError, match="'html'"):
        render(board({"good": GOOD}), "html")


def test_pipelines_that_use_what_the_scene_gives_are_marked():
    text = render(board({"good": GOOD}, given="births,starts"))
    assert "good°" in text
    assert "uses what the scene gives out: good: births,starts" in text


def test_text_is_one_header_line_aligned_rows_and_notes():
    lines = render(board({"good": GOOD, "bad": BAD}, failed=[("bad", "room1", 0)])).splitlines()
    assert lines[0].startswith("ospa ↓ (m), 8 scenarios × 2 reps")
    assert lines[1].startswith(" 1 good  (sonobench 0.1.0)")
    assert lines[1].index("[") == lines[2].index("[") == lines[0].index("95% CI")
    assert lines[3].startswith("95% CI: bootstrap-t over 8 scenarios (2 repetitions of a scenario pooled first)")


def test_every_format_holds_the_same_rows():
    table = board({"good": GOOD, "bad": BAD, "lost": dict.fromkeys(GOOD, (math.nan, 0.0, 0.0))}, vs="good")
    text = render(table, "csv")
    assert pd.read_csv(io.StringIO(text))["pipeline"].tolist() == ["good", "bad", "lost"]
    found = json.loads(render(table, "json"))
    assert [r["rank"] for r in found["rows"]] == [1, 2, None]
    assert found["board"]["metric"] == "ospa"
    back = pd.read_parquet(io.BytesIO(render(table, "parquet")))
    np.testing.assert_array_equal(back["mean"], table["mean"])
    assert back.attrs["metric"] == "ospa"
    assert render(table, "md").count("\n| ") == 2 + 3


def test_a_board_is_a_function_of_its_tables_whatever_the_order_of_their_rows():
    trials, scores = run({"good": GOOD, "bad": BAD})
    shuffled = leaderboard(trials.sample(frac=1, random_state=1), scores.sample(frac=1, random_state=2), "ospa")
    assert render(shuffled, "csv") == render(leaderboard(trials, scores, "ospa"), "csv")


def test_the_tables_that_are_passed_in_stay_as_they_were():
    trials, scores = run({"good": GOOD, "bad": BAD})
    before = trials.copy(), scores.copy()
    leaderboard(trials, scores, "ospa", vs="good")
    pd.testing.assert_frame_equal(trials, before[0])
    pd.testing.assert_frame_equal(scores, before[1])


def test_what_nobody_has_a_score_of_is_said():
    values = {p: {(f"room{s}", 0): 1.0 + s for s in range(3)} for p in "ab"}
    board = leaderboard(*run(values, unscored=[("a", "room1", 0), ("b", "room1", 0)]), "ospa")
    assert "1 of 3 blocks (scenario and repetition) has no score at all and counts for nobody." in board.attrs["notes"]
    assert not any("no score at all" in note for note in leaderboard(*run(values), "ospa").attrs["notes"])


def test_a_scenario_in_which_a_pipelines_score_has_no_weight_is_left_out_for_all():
    weightless = GOOD | {("room1", r): (0.3, 0.0, 1.0) for r in (0, 1)}
    table = board({"good": weightless, "bad": BAD})
    kept = [v for (room, _), v in BAD.items() if room != "room1"]
    assert table.attrs["units"] == 7
    assert row(table, "bad")["mean"] == pytest.approx(np.mean(kept))
    assert table["rank"].tolist() == [1, 2]


def test_a_median_over_trials_stands_beside_the_mean_that_one_lost_run_moves():
    values = grid(lambda s, r: 9.0 if (s, r) == (0, 0) else 0.1, 3, 3)
    found = row(board({"a": values}, also=["median:ospa"]), "a")
    assert found["mean"] > 1.0
    assert found["median:ospa"] == pytest.approx(0.1)
    assert "median:ospa" in render(board({"a": values}, also=["median:ospa"]))


def test_a_median_over_trials_of_a_metric_with_a_value_at_every_time_is_refused():
    trials, scores = run({"a": grid(lambda s, r: 0.1, 3, 3)}, "ospa")
    twice = pd.concat([scores, scores.assign(slice="1")], ignore_index=True)
    with pytest.raises(InputError, match="one a trial"):
        leaderboard(trials, twice, "ospa", also=["median:ospa"])
