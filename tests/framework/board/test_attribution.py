"""What swapping one component is worth."""

from __future__ import annotations

import json

import numpy as np
import pytest
from board_runs import grid, run

from sonobench.board import attribution, render
from sonobench.board.attribution import pairs_of
from sonobench.errors import InputError

RNG = np.random.default_rng(4)
ROLES = {"front_end": "front_end", "front_end.delay": "delay", "tracker": "tracker", "tracker.transform": "transform"}


def entry(delay="phat", transform="cubature", use="gm-phd", **more):
    table = {
        "use": "pipeline",
        "front_end": {"use": "gcc-peaks", "delay": {"use": delay, **more}},
        "tracker": {"use": use, "transform": {"use": transform}},
        "given": [],
    }
    return {"table": table, "roles": ROLES}


ENTRIES = {f"{d}-{t}": entry(d, t) for d in ("phat", "floor") for t in ("cubature", "linearised", "unscented")}
SCENES = RNG.normal(0.5, 0.1, 12)


def effects(scenes=12, seed=1, **planted):
    """Runs whose values are a scene's level, what each component adds, and noise."""
    rng = np.random.default_rng(seed)
    own = {name: sum(planted.get(part, 0.0) for part in name.split("-")) for name in ENTRIES}
    return run({n: grid(lambda s, r, v=v: SCENES[s] + v + 0.02 * rng.normal(), scenes, 3) for n, v in own.items()})


def attributed(tables, role, entries=None, **more):
    return attribution(*tables, "ospa", role, ENTRIES if entries is None else entries, **more)


def test_a_planted_effect_is_recovered_over_all_pairs_and_a_null_one_is_not_claimed():
    tables = effects(floor=0.1)
    delay = attributed(tables, "delay")
    found = delay.iloc[0]
    assert (found["swap_from"], found["swap_to"], found["pairs"], found["better"]) == ("floor", "phat", 3, "phat")
    assert found["low"] < -0.1 < found["high"] < 0
    assert found["effect"] == pytest.approx(-0.1, abs=0.02)
    assert found["p"] == pytest.approx(2 / 2**12)
    transform = attributed(tables, "transform")
    assert transform["pairs"].tolist() == [2, 2, 2]
    assert transform["better"].tolist() == ["", "", ""]
    assert (transform["low"] < 0).all()
    assert (transform["high"] > 0).all()


def test_null_effects_are_seldom_claimed():
    claimed = [bool(attributed(effects(seed=k), "transform")["better"].any()) for k in range(40)]
    assert np.mean(claimed) <= 0.15


def test_the_effect_is_the_mean_of_the_paired_differences_of_its_pairs():
    trials, scores = effects(linearised=0.05)
    value = scores.set_index("trial_key")["value"].groupby(lambda key: key.split("/")[0]).mean()
    found = attributed((trials, scores), "transform").set_index(["swap_from", "swap_to"])["effect"]
    assert found["cubature", "linearised"] == pytest.approx(
        np.mean([value[f"{d}-linearised"] - value[f"{d}-cubature"] for d in ("phat", "floor")])
    )


def test_entries_that_differ_in_more_than_the_component_are_no_pair():
    entries = {"a": entry(), "b": entry("floor"), "c": entry("floor", use="smc-phd"), "d": entry(transform="unscented", use="smc-phd")}
    assert [(p.first, p.second) for p in pairs_of(entries, "delay")] == [("b", "a")]
    assert {frozenset(p[:2]) for p in pairs_of(entries, "tracker")} == {frozenset("bc"), frozenset("ad")}
    assert list(pairs_of(entries, "transform")) == []


def test_components_of_one_use_are_told_apart_by_what_differs():
    entries = {"a": entry(floor=0.1, top=1), "b": entry(floor=0.2, top=1)}
    tables = run({n: grid(lambda s, r: RNG.normal(), 8, 1) for n in entries})
    found = attributed(tables, "delay", entries).iloc[0]
    assert (found["swap_from"], found["swap_to"]) == ("phat[floor=0.1]", "phat[floor=0.2]")


def test_components_in_a_list_are_found():
    entries = {
        n: {"table": {"use": "pipeline", "stages": [{"use": "x"}, {"use": n}]}, "roles": {"stages.0": "delay", "stages.1": "delay"}}
        for n in "ab"
    }
    assert [(p.first, p.second) for p in pairs_of(entries, "delay")] == [("a", "b")]


def test_higher_is_better_where_the_metric_says_so():
    trials, scores = effects(floor=0.1)
    assert attributed((trials, scores.assign(better="higher")), "delay")["better"].tolist() == ["floor"]


def test_below_six_scenarios_nothing_is_claimed_and_the_number_needed_is_said():
    found = attributed(effects(5, floor=0.3), "delay")
    assert found["better"].tolist() == [""]
    assert np.isnan(found["p"][0])
    assert "6 are needed" in render(found)


def test_pairs_that_cannot_be_ranked_are_left_out_and_named():
    trials, scores = effects(floor=0.1)
    scores = scores[~scores["trial_key"].str.startswith("phat-cubature/")]
    found = attributed((trials, scores), "delay")
    assert found["pairs"].tolist() == [2]
    assert "left out, since they cannot be ranked: phat-cubature" in render(found)


def test_without_any_rankable_pair_the_table_is_empty_and_still_prints():
    trials, scores = effects()
    found = attributed((trials, scores.assign(value=np.nan)), "delay")
    assert found.empty
    for format in ("text", "md", "csv", "json"):
        render(found, format)


def test_it_splits_by_scene_and_prints_in_every_format():
    found = attributed(effects(floor=0.1), "delay", by="scene")
    assert len(found) == 12
    assert found.attrs["groups"][0]["over"] == "repetitions"
    assert "scene = room0: delay: ospa" in render(found)
    assert json.loads(render(found, "json"))["rows"][0]["pairs"] == 3
    assert render(found, "md").count("floor → phat") == 12


def test_the_text_lines_up():
    lines = render(attributed(effects(floor=0.1), "transform")).splitlines()
    assert lines[0].startswith("transform: ospa ↓ (m), 12 scenarios × 3 reps")
    assert lines[1].lstrip().startswith("cubature → linearised")
    assert lines[1].index("[") == lines[2].index("[") == lines[0].index("95% CI")


def test_what_cannot_be_attributed_is_refused_with_the_reason():
    tables = effects()
    with pytest.raises(InputError, match=r"--attribute dealy: no such role; did you mean 'delay'"):
        attributed(tables, "dealy")
    with pytest.raises(InputError, match="no entry has a component of this role"):
        attributed(tables, "birth")
    with pytest.raises(InputError, match="no two entries differ in their tracker alone"):
        attributed(tables, "tracker", {n: entry(d) for n, d in zip(ENTRIES, "abcdef", strict=True)})
    with pytest.raises(InputError, match="does not say what its entries are made of"):
        attributed(tables, "delay", {})


def test_what_a_component_holds_is_not_its_own_swap_unless_it_is_of_another_use():
    entries = {"a": entry(), "b": entry(transform="unscented"), "c": entry(use="smc-phd", transform="linearised")}
    assert {frozenset(p[:2]) for p in pairs_of(entries, "tracker")} == {frozenset("ac"), frozenset("bc")}
    entries["d"] = entry()
    entries["d"]["table"]["tracker"]["particles"] = 300
    assert frozenset("ad") in {frozenset(p[:2]) for p in pairs_of(entries, "tracker")}


def test_against_one_pipeline_only_swaps_of_its_component_stand_there_and_begin_with_it():
    tables = effects(floor=0.1)
    found = attributed(tables, "transform", vs="phat-linearised")
    assert list(zip(found["swap_from"], found["swap_to"], strict=True)) == [("linearised", "cubature"), ("linearised", "unscented")]
    assert found["pairs"].tolist() == [1, 1]
    value = tables[1].set_index("trial_key")["value"].groupby(lambda key: key.split("/")[0]).mean()
    assert found["effect"].tolist() == pytest.approx([value[f"phat-{t}"] - value["phat-linearised"] for t in ("cubature", "unscented")])
    with pytest.raises(InputError, match="no pipeline 'nobody' to compare with"):
        attributed(tables, "transform", vs="nobody")
    alone = ENTRIES | {"phat-cubature": entry(use="smc-phd")}
    with pytest.raises(InputError, match="no entry differs from phat-cubature in its delay alone"):
        attributed(tables, "delay", alone, vs="phat-cubature")
