"""Published numbers: their table, and their place beside the measured ones."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import pandas as pd
import pytest
from board_runs import grid, run

from sonobench.board import beside, leaderboard, render
from sonobench.errors import TableError
from sonobench.registry import Registry
from sonobench.scene.reference import Reference

REGISTRY = Registry.load()
COLUMN = "p_scene.noise.snr_db"
METRICS = {"ospa": {"use": "ospa", "p": 2.0, "c_m": 1.5, "components": None}}
TABLE = {
    "table": "Table 2",
    "metric": "ospa",
    "settings": {"c_m": 1.5},
    "unit": "m",
    "at": {"scene": {"noise": {"snr_db": [10, 20]}}},
    "values": {"good": [0.5, 0.3], "glmb": [0.2, 0.1]},
}


def reference(*tables, name="paper", **more):
    return Reference.from_table({"citation": "Doe 2020, Acta 3, 1-9", "tables": list(tables)} | more, name, REGISTRY)


def swept(values=(10.0, 20.0)):
    own = {"good": grid(lambda s, r: 0.4 + s / 100, 8, 2), "bad": grid(lambda s, r: 0.9 + s / 90, 8, 2)}
    parts = [run(own, **{COLUMN: v}) for v in values]
    return tuple(pd.concat([p.assign(trial_key=p["trial_key"] + str(k)) for k, p in enumerate(side)]) for side in zip(*parts, strict=True))


def printed(board, *references, metrics=METRICS, column="ref.paper"):
    table = beside(board, references, metrics)
    return table, dict(zip(table["pipeline"], table[column], strict=True))


def test_a_board_of_one_setting_has_the_number_printed_for_it_and_the_citation():
    table = beside(leaderboard(*swept(), "ospa", by="snr_db"), [reference(TABLE)], METRICS)
    assert table["ref.paper"].tolist()[::2] == [0.5, 0.3]
    assert table["ref.paper"].isna().tolist() == [False, True] * 2
    columns = list(table.columns)
    assert columns[columns.index("mean") + 1] == "ref.paper"
    text = render(table)
    assert "paper printed" in text
    assert "paper: printed in Table 2 of Doe 2020, Acta 3, 1-9; neither measured nor ranked here. It also prints glmb 0.1." in text
    assert json.loads(render(table, "json"))["rows"][1]["ref.paper"] is None


def test_a_board_over_several_settings_has_the_mean_of_the_numbers_if_all_are_printed():
    assert printed(leaderboard(*swept(), "ospa"), reference(TABLE))[1]["good"] == pytest.approx(0.4)
    table, values = printed(leaderboard(*swept((10.0, 20.0, 30.0)), "ospa"), reference(TABLE))
    assert math.isnan(values["good"])
    assert "does not print all of this board's values of scene.noise.snr_db" in render(table)


def test_a_number_without_settings_stands_on_every_board():
    everywhere = TABLE | {"at": {}, "values": {"good": 0.7}}
    assert printed(leaderboard(*swept(), "ospa"), reference(everywhere))[1]["good"] == 0.7


def test_numbers_by_scene_stand_on_the_boards_of_their_scenes():
    by_scene = TABLE | {"at": {"scene": ["room1", "room0"]}, "values": {"good": [0.1, 0.2]}}
    table = beside(leaderboard(*swept(), "ospa", by="scene"), [reference(by_scene)], METRICS)
    assert table.loc[table["pipeline"] == "good", "ref.paper"].tolist()[:2] == [0.2, 0.1]


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"metric": "gospa", "settings": {}}, "it prints gospa, not ospa"),
        ({"settings": {"c_m": 1.0}}, r"its ospa has c_m = 1.0 \(here 1.5\)"),
        ({"unit": "rad"}, "its unit is rad, not m"),
        ({"at": {"scene": {"room": {"t60_s": [0.1, 0.2]}}}}, "it prints over scene.room.t60_s, which the study does not sweep"),
    ],
)
def test_a_number_about_something_else_is_not_shown_and_the_board_says_why(change, why):
    table, values = printed(leaderboard(*swept(), "ospa"), reference(TABLE | change))
    assert all(math.isnan(v) for v in values.values())
    assert re.search(f"paper prints nothing to stand here: {why}", render(table))


def test_the_second_table_steps_in_where_the_first_does_not_print():
    second = TABLE | {"table": "Table 9", "at": {"scene": {"noise": {"snr_db": [30]}}}, "values": {"good": [0.9]}}
    table = beside(leaderboard(*swept((10.0, 30.0)), "ospa", by="snr_db"), [reference(TABLE, second)], METRICS)
    assert table["ref.paper"].dropna().tolist() == [0.5, 0.9]
    assert "printed in Table 9" in table.attrs["groups"][1]["notes"][-1]


def test_several_references_have_a_column_each_and_one_that_cannot_be_read_a_note():
    board = leaderboard(*swept(), "ospa")
    table = beside(board, [reference(TABLE), reference(TABLE, name="other")], METRICS, {"gone": "gone.toml: no such file"})
    assert [c for c in table.columns if c.startswith("ref.")] == ["ref.paper", "ref.other"]
    assert "gone cannot be read here: gone.toml: no such file." in render(table)
    assert "ref.paper" not in board.columns
    assert "references" not in board.attrs


def test_all_faults_of_a_reference_are_told_at_once():
    bad = {"table": "T", "metric": "opsa", "unit": 3, "at": {"scene": {"a": [1, 2], "b": [1]}, "foo": [1, 2]}, "valeus": {}}
    wrong = TABLE | {"settings": {"c": 1}, "values": {"x": [1, math.nan], "y": [1], "z": 2}}
    with pytest.raises(TableError) as caught:
        reference(bad, wrong, citatoin="x", citation="")
    text = "\n".join(caught.value.faults)
    for said in (
        "paper.toml: citatoin: a reference has no such key; did you mean 'citation'?",
        "paper.toml: citation: a text is needed, got ''",
        "tables[0].valeus: no such key; did you mean 'values'?",
        "tables[0].unit: a text is needed, got 3",
        "no metric is named 'opsa'; did you mean 'ospa'?",
        "tables[0].at.foo: begins with neither scene nor pipelines",
        "lists side by side are needed, got lengths",
        "tables[0].values: numbers by pipeline are needed, got None",
        "tables[1].settings.c: Ospa has no such field",
        "tables[1].values.x: finite numbers are needed",
        "tables[1].values.y: a list of 2 numbers, as `at` has, is needed, got [1]",
        "tables[1].values.z: a list of 2 numbers",
    ):
        assert said in text


COST = {"table": "Table 7", "metric": "ms/frame", "unit": "ms", "scale": 1e3, "values": {"good": 0.25}}


def test_printed_times_stand_beside_the_measured_ones_and_not_beside_the_metric():
    board = leaderboard(*swept(), "ospa")
    table = beside(board, [reference(COST)], METRICS)
    assert dict(zip(table["pipeline"], table["ref_ms_per_frame.paper"], strict=True))["good"] == 250.0
    columns = list(table.columns)
    assert columns[columns.index("ms_per_frame") + 1] == "ref_ms_per_frame.paper"
    assert "ref.paper" not in columns
    text = render(table)
    assert re.search(r"ms/frame +paper printed", text)
    assert "paper: ms/frame printed in Table 7 of Doe 2020" in text
    both = render(beside(board, [reference(COST, TABLE)], METRICS))
    assert re.search(r"mean +paper printed.*ms/frame +paper printed", both)


def test_a_time_printed_for_another_scene_is_not_shown_and_the_board_says_why():
    elsewhere = COST | {"at": {"scene": ["cellar"]}, "values": {"good": [0.25]}}
    table = beside(leaderboard(*swept(), "ospa"), [reference(elsewhere)], METRICS)
    assert table["ref_ms_per_frame.paper"].isna().all()
    assert "paper prints no ms/frame to stand here: it does not print all of this board's values of scene" in render(table)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"unit": "s"}, r"metric: ms/frame has no settings and the unit ms, got \{\} and 's'"),
        ({"settings": {"p": 2.0}}, r"metric: ms/frame has no settings and the unit ms, got \{'p': 2.0\}"),
        ({"scale": 0}, "scale: a number above 0 is needed, got 0"),
    ],
)
def test_faults_of_printed_times_are_named(change, said):
    with pytest.raises(TableError, match=said):
        reference(COST | change)


def test_two_numbers_for_one_thing_are_refused_and_the_same_number_twice_is_not():
    reference(TABLE, TABLE | {"table": "Table 4"})
    with pytest.raises(TableError, match=r"Table 4 prints 0.6 for good at \{'scene.noise.snr_db': 10.0\}, Table 2 prints 0.5"):
        reference(TABLE, TABLE | {"table": "Table 4", "values": {"good": [0.6, 0.3]}})


def test_every_shipped_reference_is_valid_and_chen2012_has_what_its_tables_print():
    for name in REGISTRY.data_files("reference", ".toml"):
        Reference.load(name, REGISTRY)
    chen = {t.table: t for t in Reference.load("chen2012", REGISTRY).tables}
    assert sorted(chen) == ["Table 2", "Table 3", "Table 4", "Table 5"]
    assert chen["Table 2"].values["ck-phd"] == (1.4351, 1.4345, 1.3450, 0.8540, 0.5799)
    assert chen["Table 3"].values["ek-phd"] == (2.5430, 2.5505, 2.2175, 0.3073, 0.0329)
    for one in ("ek-phd", "uk-phd", "ck-phd"):  # 25 dB and .2 s are one setting, printed in two tables
        assert chen["Table 2"].values[one][3] == chen["Table 4"].values[one][0]
        assert chen["Table 3"].values[one][3] == chen["Table 5"].values[one][0]


def test_liang2016_has_the_times_that_its_tables_print_in_milliseconds_a_frame():
    small, big = Reference.load("liang2016", REGISTRY).tables
    assert small.at == {"scene.noise.snr_db": (-10, 0, 10, 20)}
    assert small.values["phat"] == pytest.approx((24.260, 24.468, 22.588, 22.433))
    assert sorted(small.values) == ["cc", "phat", "roth", "scot"]
    runs_s = {name: values[0] * 50 / 1e3 for name, values in big.values.items()}  # of 50 frames
    assert [runs_s[f"smc[particles={n},born_particles=100]"] for n in (200, 400, 600)] == pytest.approx([230.406124, 429.516077, 603.45778])
    assert len(runs_s) == 16


def test_no_plugin_reads_printed_values():
    import sonobench_plugins._register as register

    for file in Path(register.__file__).parent.rglob("*.py"):
        assert "scene.reference" not in file.read_text("utf-8")
        assert '"reference"' not in file.read_text("utf-8")
