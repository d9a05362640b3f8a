"""Boards of a real run: what a study says reaches them."""

from __future__ import annotations

import json

import pytest

from sonobench.board import render
from sonobench.errors import TableError
from sonobench.scene import Study

PHD = """{ use = "pipeline", given = ["births"], front_end = { use = "recorded" }, tracker = { use = "%s", birth = { use = "given" } } }"""
STUDY = f"""
scenes = ["chen2012"]
repetitions = 6
metrics = [{{ use = "ospa", p = 2.0, c_m = 1.5, components = ["x_m", "vx_m_s", "y_m", "vy_m_s"] }}, "cardinality"]
reference = ["chen2012"]
[pipelines]
ck-phd = {PHD % "ck-phd"}
ek-phd = {PHD % "ek-phd"}
narrow = {PHD.replace('"given" }', '"given" }, prune_weight = 1e-3') % "ck-phd"}
[sweep]
scene.simulator.delay_std_s = [55e-6, 125e-6]
"""


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("chen")
    (folder / "s.toml").write_text(STUDY)
    return Study.load(folder / "s.toml").run(out=folder / "run", in_process=True)


def test_published_numbers_stand_beside_the_measured_ones_of_the_same_setting(run):
    board = run.board(by="delay_std_s").set_index(["p_scene.simulator.delay_std_s", "pipeline"])["ref.chen2012"]
    assert board[125e-6, "ck-phd"] == 0.8540
    assert board[55e-6, "ek-phd"] == 0.5870
    assert board.isna().sum() == 2  # of the entry that the paper does not have
    assert run.board("cardinality.are", by="delay_std_s")["ref.chen2012"].max() == 0.3073
    assert "it prints cardinality.are, ospa, not ospa.localisation" in render(run.board("ospa.localisation"))


def test_entries_that_differ_in_one_component_are_found_in_what_the_run_wrote(run):
    found = run.attribution("transform", by="delay_std_s")
    assert found[["swap_from", "swap_to", "pairs"]].drop_duplicates().values.tolist() == [["cubature", "linearised", 1]]
    assert found.attrs["groups"][0]["swaps"] == [[["ck-phd", "ek-phd"]]]
    trackers = run.attribution("tracker", by="delay_std_s")
    assert [["narrow", "ck-phd"]] in trackers.attrs["groups"][0]["swaps"]
    json.loads(render(trackers, "json"))


def test_a_study_that_names_no_such_reference_is_refused_with_its_other_faults(tmp_path):
    (tmp_path / "mine.toml").write_text('citation = "x"')
    (tmp_path / "s.toml").write_text(
        STUDY.replace('["chen2012"]\n[pip', '["chen2021", "mine.toml"]\n[pip').replace("repetitions = 6", "repetitions = 0")
    )
    with pytest.raises(TableError) as caught:
        Study.load(tmp_path / "s.toml")
    text = "\n".join(caught.value.faults)
    assert "repetitions: an integer of at least 1 is needed" in text
    assert "s.toml: reference: no reference is named 'chen2021'; did you mean 'chen2012'?" in text
    assert "mine.toml: tables: at least one [[tables]] is needed" in text
