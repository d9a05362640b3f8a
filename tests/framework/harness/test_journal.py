"""The journal's index: lines that are whole are not decoded, all others are; the index is the same either way."""

from __future__ import annotations

import json

import pytest

from sonobench.harness.journal import Journal, encoded, read
from sonobench.harness.rows import OWN_NAMES, SHARED_NAMES, shared_name, whole_name

ROW = dict.fromkeys((*SHARED_NAMES, *OWN_NAMES), "") | {"trial_key": "t1", "estimate_key": "e1", "status": "ok", "open": False, "p_x": 1}
SCORES = {"s1": {"rows": [{"value": 1.0}]}, "s2": {"rows": []}}
FAULT = {"error": "crash: as told", "status": "crash"}


def name(row):
    return whole_name(shared_name(row), *(row[k] for k in OWN_NAMES))


def index(recorded):
    return {
        "trials": dict(recorded.trials),
        "outputs": dict(recorded.outputs),
        "scores": dict(recorded.scores),
        "recordings": recorded.recordings,
    }


@pytest.fixture
def path(tmp_path):
    journal = Journal(tmp_path / "journal.jsonl")
    journal.add(recording={"r1": ("i", "t")})
    journal.add(trial=ROW)
    journal.add(trial_key="t1", scores=SCORES)
    journal.add(trial=ROW | {"trial_key": "t2", "estimate_key": "e2", "status": "error"})
    journal.add(trial_key="t2", scores={"s3": FAULT})
    journal.add(trial=ROW | {"trial_key": "t3", "estimate_key": "e3", "open": True})
    journal.close()
    assert index(journal.recorded) == index(read(journal.path))
    return journal.path


def test_what_is_added_is_what_is_read(path):
    found = read(path)
    assert found.recordings == {"r1": ("i", "t")}
    assert found.trials["t1"] == ROW
    assert set(found.trials) == {"t1", "t2", "t3"}
    assert set(found.outputs) == {"e1", "e3"}
    assert dict(found.scores) == SCORES | {"s3": FAULT}
    assert found.scores.several(["s3", "s2", "gone", "s1"]) == dict(found.scores)
    assert found.trials.several(["t3", "t1"]) == {k: found.trials[k] for k in ("t1", "t3")}


def test_only_what_ended_well_is_plain(path):
    found = read(path)
    assert {k for k in found.trials if found.trials.is_plain(k)} == {"t1"}
    assert {k for k in found.scores if found.scores.is_plain(k)} == {"s1", "s2"}


def test_a_trial_is_known_by_its_name_and_its_output_without_decoding_its_line(path, monkeypatch):
    found = read(path)
    monkeypatch.setattr("sonobench.harness.journal._decode", None)
    assert found.is_named("t1", "e1", name(ROW))
    assert not found.is_named("t1", "e2", name(ROW))
    assert not found.is_named("t2", "e2", name(ROW | {"trial_key": "t2"})), "it failed"
    assert not found.is_named("t3", "e3", name(ROW | {"trial_key": "t3"})), "it is open"
    assert not found.is_named("gone", "e1", name(ROW))


@pytest.mark.parametrize("changed", [*SHARED_NAMES, *OWN_NAMES, "p_x", "p_new"])
def test_a_name_holds_each_part_of_it(changed):
    assert name(ROW | {changed: "other"}) != name(ROW)


def test_a_later_line_about_a_trial_holds(path):
    with path.open("ab") as file:
        file.write(encoded({"trial": ROW | {"status": "error"}}))
    assert read(path).trials["t1"]["status"] == "error"
    assert not read(path).is_named("t1", "e1", name(ROW))


def test_lines_without_a_head_are_read_by_decoding_them(path):
    lines = [json.loads(line) for line in path.read_bytes().splitlines()]
    bare = path.with_name("bare")
    bare.write_text("".join(json.dumps({k: v for k, v in line.items() if k not in ("crc", "is")}) + "\n" for line in lines))
    assert index(read(bare)) == index(read(path))
    assert not read(bare).trials.is_plain("t1")


def test_a_line_torn_at_any_byte_costs_that_line_alone(path):
    lines = path.read_bytes().splitlines(keepends=True)
    whole = index(read(path))
    for end in range(len(lines[1]) - 1):
        path.write_bytes(lines[0] + lines[1][:end] + b"\n" + b"".join(lines[2:]))
        found = index(read(path))
        assert found["trials"].keys() == {"t2", "t3"}
        assert found["scores"] == whole["scores"]


def test_a_head_that_was_altered_is_not_believed(path):
    text = path.read_bytes()
    path.write_bytes(text.replace(b' e1",', b' e9",'))
    found = read(path)
    assert set(found.outputs) == {"e1", "e3"}
    assert not found.is_named("t1", "e9", name(ROW))
    path.write_bytes(text.replace(b'"p_x":1', b'"p_x":2', 1))
    assert read(path).trials["t1"]["p_x"] == 2
    assert not read(path).trials.is_plain("t1")
