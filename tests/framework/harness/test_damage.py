"""Damaged, foreign and unwritable files: said in words, never a traceback, and no trial's fault."""

from __future__ import annotations

import errno
import json
import shutil

import pandas as pd
import pytest
from harness_study import STUDY, write_study

from sonobench.cli import main
from sonobench.files import no_room
from sonobench.harness import run_study
from sonobench.harness.cell import Limits
from sonobench.harness.journal import read
from sonobench.harness.progress import Silent
from sonobench.harness.rows import DISK, stands
from sonobench.scene.study import Study

ONE = STUDY.replace(', "two.toml"', "").replace("repetitions = 2", "repetitions = 1")
AGAIN = "run the study again to have it written"


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A finished run and its study."""
    folder = tmp_path_factory.mktemp("whole")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
        run_study(Study.load(write_study(folder, ONE)), out=folder / "runs/tiny", in_process=True, display=Silent())
    return folder


@pytest.fixture
def run(whole, tmp_path, monkeypatch):
    """A copy of it to be damaged; the current folder is its study's."""
    shutil.copytree(whole / "runs", tmp_path / "runs")
    write_study(tmp_path, ONE)
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path / "runs/tiny"


@pytest.fixture
def said(capsys):
    def call(*arguments):
        capsys.readouterr()
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        out, err = capsys.readouterr()
        assert ended.value.code != 1, err
        return ended.value.code, err if ended.value.code == 2 else out

    return call


def no_column(table, *names):
    def damage(run):
        path = run / f"{table}.parquet"
        pd.read_parquet(path).drop(columns=list(names)).to_parquet(path)

    return damage


def content(name, data):
    return lambda run: (run / name).write_bytes(data)


def gone(*names):
    return lambda run: [(run / name).unlink() for name in names]


BOARDS = {
    "trials.parquet: cannot be read": content("trials.parquet", b"PAR1 nonsense"),
    "scores.parquet: cannot be read": content("scores.parquet", b"PAR1 nonsense"),
    "lacks the columns ['value']": no_column("scores", "value"),
    "lacks the columns ['pipeline', 'status']": no_column("trials", "pipeline", "status"),
    "has no trials.parquet": gone("trials.parquet"),
    "study.json: is not what a run writes": content("study.json", b"[]"),
    "study.json: does not say which study was run": content("study.json", b'{"schema": 1}'),
    "study.json: cannot be read": content("study.json", b"{"),
    "version 1 of a run is needed, got 99": content("study.json", b'{"schema": 99}'),
}


@pytest.mark.parametrize("message", BOARDS)
def test_a_board_of_damaged_files_says_which_and_what_to_do(run, said, message):
    BOARDS[message](run)
    code, text = said("board", "tiny")
    assert code == 2
    assert text.startswith(f"error: {run}")
    assert message in text
    assert AGAIN in text or "parquet: " not in text


def test_board_verify_does_not_pass_over_damaged_scores(run, said):
    content("scores.parquet", b"PAR1 nonsense")(run)
    code, text = said("board", "tiny", "--verify")
    assert (code, "verified" in text) == (2, False)


@pytest.mark.parametrize("table", ["trials", "scores"])
def test_running_again_writes_damaged_tables_anew_without_a_trial(run, said, table):
    journal = (run / "journal.jsonl").read_bytes()
    no_column(table, "trial_key")(run)
    assert said("run", "tiny.toml", "--in-process")[0] == 0
    assert (run / "journal.jsonl").read_bytes() == journal


def test_why_reads_the_journal_where_the_tables_are_damaged_and_says_where_nothing_is_left(run, said):
    no_column("trials", "pipeline")(run)
    assert "the next run keeps it" in said("why", "guesser/one/0", "tiny")[1]
    gone("journal.jsonl")(run)
    code, text = said("why", "guesser/one/0", "tiny")
    assert code == 2
    assert "the journal has no trial either" in text


def test_why_without_a_journal_or_parts_tells_the_rest(run, said):
    content("parts.jsonl", b"nonsense")(run)
    found = json.loads(said("why", "guesser/one/0", "tiny", "--json")[1])
    assert found["changed"] == ["unknown: parts.jsonl, which says what it was made of, is missing or damaged"]
    assert found["verdict"] == "the next run keeps it"
    gone("journal.jsonl")(run)
    assert "not there" in said("why", "guesser/one/0", "tiny")[1]


def test_lines_of_a_journal_that_are_not_its_own_say_nothing(run):
    path = run / "journal.jsonl"
    whole = read(path)
    trials, scores = dict(whole.trials), dict(whole.scores)
    lines = path.read_bytes().splitlines(keepends=True)
    strange = [b'{"trial": 3}\n', b"[1]\n", b'{"trial":{"trial_key":"x"}}\n', b'{"scores": 5}\n', b'{"recording": {"a": 1}}\n', b"\xff{\n"]
    path.write_bytes(b"".join([lines[0], *strange, *lines[1:]]))
    again = read(path)
    assert again.recordings == whole.recordings
    assert (dict(again.trials), dict(again.scores)) == (trials, scores)


def test_a_foreign_folder_is_refused_by_a_dry_run_too(run, said):
    assert "is no run's folder" in said("run", "tiny.toml", "--dry-run", "--out", ".")[1]
    shutil.rmtree(run / "estimates")
    (run / "estimates").write_text("mine")
    code, text = said("run", "tiny.toml", "--in-process")
    assert code == 2
    assert "estimates: the folder cannot be made" in text


def test_values_that_are_no_limit_and_names_that_are_files_are_explained(run, said):
    assert "timeout_s is nan; a positive number is needed" in said("run", "tiny.toml", "--timeout", "nan")[1]
    assert "memory_mb is inf; a positive number is needed" in said("run", "tiny.toml", "--memory", "inf")[1]
    assert "goes by its whole name, tiny.toml" in said("run", "tiny")[1]


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_full_disk_is_no_trials_fault_and_is_tried_again(run, said, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("sonobench.log.write_recording", full)
        assert said("run", "tiny.toml", "--in-process", "--fresh")[0] == 3
    row = pd.read_parquet(run / "trials.parquet").iloc[0]
    assert (row["exc_type"], row["status"]) == (DISK, "error")
    assert "No space left on device" in row["exc_message"]
    assert not stands(row, Limits())
    assert said("run", "tiny.toml", "--in-process")[0] == 0


def test_a_full_disk_under_the_runs_own_files_is_an_input_error(run, said, monkeypatch):
    monkeypatch.setattr("sonobench.harness.run_folder.replace_file", full)
    code, text = said("run", "tiny.toml", "--in-process")
    assert code == 2
    assert "No space left on device; what was finished is kept: make room and start again" in text
    assert no_room(OSError(errno.EROFS, "read-only"))
    assert not no_room(OSError(errno.ENOENT, "gone"))
