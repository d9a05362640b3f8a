"""What a second run does again: what changed, what was never finished, what met a limit that is higher now, and what is asked for."""

from __future__ import annotations

import json
from collections import Counter

import pytest
from harness_study import PLUGIN, SCENE, STUDY, write_study

from sonobench.errors import InputError
from sonobench.harness.cell import Limits
from sonobench.harness.progress import Silent
from sonobench.harness.rows import stands
from sonobench.scene.study import Study

ONE = STUDY.replace('"one.toml", ', "").replace("repetitions = 2", "repetitions = 1")
FAULTY = """

@dataclass(frozen=True)
class Leaky:
    needs_sound = False

    def simulate(self, scene, seed):
        raise OSError("the room leaks")
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("SONOBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def study(folder, pipelines, plugin=PLUGIN, text=ONE):
    return Study.load(write_study(folder, text.replace("guesser = {}", "\n".join(f"{p} = {{}}" for p in pipelines)), plugin))


def run(loaded, **options):
    return loaded.run(out="run", **{"in_process": True, "display": Silent(), **options})


def attempts(finished):
    return dict(zip(finished.trials["pipeline"], finished.trials["attempts"], strict=True))


def lines(folder):
    return [json.loads(line) for line in (folder / "run/journal.jsonl").read_bytes().splitlines()]


def test_failures_of_unchanged_code_are_kept_and_retried_when_asked_for(folder):
    loaded = study(folder, ["guesser", "raise", "nan", "absent"])
    first = run(loaded)
    journal = lines(folder)
    again = run(loaded)
    assert lines(folder) == journal
    assert again.trials.equals(first.trials)
    assert again.failed == 3
    assert attempts(run(loaded, retry="failed")) == {"guesser": 1, "raise": 2, "nan": 2, "absent": 1}
    assert set(run(loaded).trials["status"]) == {"ok", "error", "invalid", "unavailable"}


def test_a_failure_is_tried_again_when_its_code_was_edited(folder):
    run(study(folder, ["guesser", "raise"]))
    mended = run(study(folder, ["guesser", "raise"], PLUGIN.replace('raise RuntimeError("as told")', "pass")))
    assert list(mended.trials["status"]) == ["ok", "ok"]
    assert attempts(mended)["raise"] == 2


def test_a_scene_that_cannot_be_rendered_is_not_rendered_again_until_asked_for_or_edited(folder):
    plugin = (PLUGIN + FAULTY).replace('"metric": {', '"simulator": {"leaky": Leaky}, "metric": {')
    (folder / "bad.toml").write_text(SCENE.replace('simulator = { use = "measurements", p_d = 0.9, delay_std_s = 2e-5, clutter_per_scan = 1.0 }', 'simulator = "leaky"'))  # fmt: skip
    text = ONE.replace('"two.toml"', '"bad.toml"')
    loaded = study(folder, ["guesser", "raise"], plugin, text)
    first = run(loaded)
    assert set(first.trials["status"]) == {"error"}
    assert first.trials["exc_message"].str.contains("could not be rendered: the room leaks").all()
    journal = lines(folder)
    assert run(loaded).trials.equals(first.trials)
    assert lines(folder) == journal
    assert attempts(run(loaded, retry="failed")) == {"guesser": 2, "raise": 2}
    assert attempts(run(study(folder, ["guesser", "raise"], plugin.replace("leaks", "drips"), text))) == {"guesser": 3, "raise": 3}


def test_a_metric_that_failed_is_not_asked_again_until_asked_for_or_edited(folder):
    text = ONE.replace('["distance"]', '["distance", "raising"]')
    loaded = study(folder, ["guesser"], text=text)
    assert run(loaded).unscored.keys() == {"raising"}

    def scorings():
        return sum("scores" in line for line in lines(folder))

    assert run(loaded).unscored.keys() == {"raising"}
    assert scorings() == 1
    run(loaded, retry="failed")
    assert scorings() == 2
    assert not run(study(folder, ["guesser"], PLUGIN.replace("raise ValueError", "return {}  #"), text)).trials.empty
    assert scorings() == 3


def test_what_met_a_limit_runs_again_when_that_limit_is_raised_or_removed(folder):
    loaded = study(
        folder, ["guesser", "hang", "hog"], PLUGIN.replace("time.sleep(5)", "pass").replace("time.sleep(1000)", "time.sleep(1.6)")
    )
    limited = {"in_process": False, "jobs": 1, "timeout_s": 1.2, "memory_mb": 250}
    first = run(loaded, **limited)
    assert list(first.trials["status"]) == ["ok", "timeout", "oom"]
    assert list(first.trials["timeout_s"]) == [1.2] * 3
    journal = lines(folder)
    for lower in ({}, {"timeout_s": 0.5}, {"memory_mb": 100}):
        run(loaded, **(limited | lower))
    assert lines(folder) == journal
    longer = run(loaded, **(limited | {"timeout_s": 20.0}))
    assert list(longer.trials["status"]) == ["ok", "ok", "oom"]
    assert attempts(longer) == {"guesser": 1, "hang": 2, "hog": 1}
    assert list(run(loaded).trials["status"]) == ["ok", "ok", "ok"]  # in this process there are no limits


@pytest.mark.parametrize(
    ("failure", "now", "kept"),
    [
        ({"status": "error"}, Limits(99, 99), True),
        ({"status": "crash"}, Limits(), True),
        ({"status": "crash", "exc_type": "CellDied"}, Limits(), False),
        ({"status": "timeout", "timeout_s": 5.0}, Limits(5), True),
        ({"status": "timeout", "timeout_s": 5.0}, Limits(4), True),
        ({"status": "timeout", "timeout_s": 5.0}, Limits(6), False),
        ({"status": "timeout", "timeout_s": 5.0}, Limits(), False),
        ({"status": "timeout", "timeout_s": 5.0}, Limits(5, None), True),
        ({"status": "oom", "memory_mb": 500.0, "timeout_s": 5.0}, Limits(9, 500), True),
        ({"status": "oom", "memory_mb": 500.0}, Limits(None, 501), False),
        ({"status": "oom", "memory_mb": 500.0}, Limits(), False),
        ({"status": "oom", "memory_mb": None}, Limits(), True),  # the machine's own memory
    ],
)
def test_a_failure_stands_unless_the_limit_that_it_met_is_higher_or_it_was_killed_from_outside(failure, now, kept):
    assert stands(failure, now) is kept


def test_only_failed_can_be_retried(folder):
    with pytest.raises(InputError, match="retry is 'all'"):
        run(study(folder, ["guesser"]), retry="all")


def test_a_folder_of_a_run_that_was_killed_while_it_was_made_is_taken_up(folder):
    loaded = study(folder, ["guesser"])
    for name in ("estimates", "logs"):
        (folder / "run" / name).mkdir(parents=True)
    (folder / "run/.study.json.x1.tmp").write_text('{"sche')
    run(loaded)
    (folder / "run/estimates/.a.mcap.x2.tmp").write_text("half")
    finished = run(loaded)
    assert finished.failed == 0
    assert not list((folder / "run").rglob("*.tmp"))


def test_the_line_that_follows_a_torn_one_is_not_lost(folder):
    loaded = study(folder, ["guesser", "raise"])
    run(loaded)
    journal = folder / "run/journal.jsonl"
    journal.write_bytes(journal.read_bytes()[:-30])
    run(loaded)
    mended = journal.read_bytes()
    run(loaded)
    assert journal.read_bytes() == mended


def test_an_estimates_file_that_is_gone_is_made_again(folder):
    loaded = study(folder, ["guesser", "raise"])
    first = run(loaded)
    (first.path / first.trials["estimates_path"][0]).unlink()
    assert attempts(run(loaded)) == {"guesser": 2, "raise": 1}
    assert Counter(row["trial"]["pipeline"] for row in lines(folder) if "trial" in row) == {"guesser": 2, "raise": 1}
