"""Whatever a run looks like, a board comes out, and as JSON it is valid."""

from __future__ import annotations

import io
import itertools
import json

import numpy as np
import pandas as pd
import pytest
from board_runs import grid, run
from board_simulation import values, write
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sonobench.board import leaderboard, render
from sonobench.cli import main
from sonobench.harness import open_run, run_folder

RNG = np.random.default_rng(12)
GOOD = grid(lambda s, r: float(RNG.normal()), 7, 2)
BAD = grid(lambda s, r: 2.0 + s, 7, 2)
ALL = [(p, *k) for p in ("good", "bad") for k in GOOD]


def strict(text):
    """Parse JSON that has no NaN and no Infinity."""
    return json.loads(text, parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))


def swept(*alternatives):
    tables = [run({"good": GOOD, "bad": BAD}, **{"p_scene.x": v}) for v in alternatives]
    trials, scores = (
        pd.concat([t.assign(trial_key=t["trial_key"] + str(k)) for k, t in enumerate(side)]) for side in zip(*tables, strict=True)
    )
    return trials, scores


def edited(table, **columns):
    trials, scores = table
    return trials.assign(**{c: v for c, v in columns.items() if c in trials}), scores.assign(
        **{c: v for c, v in columns.items() if c in scores}
    )


CASES = {
    "one pipeline": run({"good": GOOD}),
    "one trial": run({"good": {("room", 0): 1.0}}),
    "two scenarios": run({"good": grid(lambda s, r: 0.0, 2, 1), "bad": grid(lambda s, r: 1.0, 2, 1)}),
    "all failed": run({"good": GOOD, "bad": BAD}, failed=ALL),
    "all failed without scores": (run({"good": GOOD, "bad": BAD}, failed=ALL)[0], run({"x": GOOD})[1]),
    "ties": run(dict.fromkeys(("good", "bad", "third"), GOOD)),
    "higher is better": run({"good": GOOD, "bad": BAD}, better="higher"),
    "undefined": run({"good": dict.fromkeys(GOOD, (np.nan, 0.0, 0.0)), "bad": BAD}),
    "infinite": run({"good": GOOD | {("room0", 0): np.inf}, "bad": BAD}),
    "no weights": edited(run({"good": GOOD, "bad": BAD}), weight=np.nan),
    "a scenario without weight": run({"good": GOOD | {("room1", r): (0.3, 0.0, 1.0) for r in (0, 1)}, "bad": BAD}),
    "no coverage": edited(run({"good": GOOD, "bad": BAD}), coverage=np.nan),
    "all zero": run({"good": grid(lambda s, r: 0.0, 7, 1), "bad": grid(lambda s, r: 0.0, 7, 1)}, pool="rms"),
    "huge and tiny": run({"good": grid(lambda s, r: 1e-60 * s, 7, 1), "bad": grid(lambda s, r: 1e60 * s, 7, 1)}),
    "a pipeline with other scenes": run({"good": GOOD, "bad": {(f"hall{s}", 0): 1.0 for s in range(7)}}),
    "missing trials": tuple(t[t["trial_key"] != "bad/room3/1"] for t in run({"good": GOOD, "bad": BAD})),
    "missing text": edited(run({"good": GOOD, "bad": BAD}), status=pd.NA, given=None, version=None, front_end_s=None, frames=pd.NA),
    "swept numbers": swept(10, 20),
    "swept texts and numbers": swept(0.5, "off"),
    "swept here and not there": swept(10, None),
    "a name with a bar and quotes": run({'a|"b"': GOOD, "bad": BAD}),
}


SPLIT = [(c, "x") for c in CASES if c.startswith("swept")]
SPLIT += [(c, "scene") for c in ("one trial", "all failed without scores", "undefined", "a pipeline with other scenes", "missing trials")]


@pytest.mark.parametrize(("case", "by"), [*((c, None) for c in CASES), *SPLIT])
def test_every_run_gives_a_board_in_every_format(case, by):
    trials, scores = CASES[case]
    vs = str(trials["pipeline"].iloc[-1])
    with np.errstate(all="raise", under="ignore", over="ignore"):
        table = leaderboard(trials, scores, "ospa", by=by, vs=vs, also=["ospa"] if by else [])
    data = strict(render(table, "json"))
    assert len(data["rows"]) == len(table) >= trials["pipeline"].nunique()
    assert render(table, "text").count("\n") >= len(table)
    assert render(table, "md").count("| ---") >= 1
    assert len(pd.read_csv(io.StringIO(render(table, "csv")))) == len(table)
    assert len(pd.read_parquet(io.BytesIO(render(table, "parquet")))) == len(table)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(st.data())
def test_any_holes_in_a_run_leave_a_board_whose_ranked_pipelines_are_complete(data):
    kinds = st.sampled_from(["ok", "ok", "ok", "failed", "unscored", "undefined", "short", "absent"])
    blocks = list(itertools.product(range(7), range(2)))
    own = {p: {(f"room{s}", r): data.draw(kinds) for s, r in blocks} for p in "abc"}
    numbers = {"ok": 0.5, "failed": 1.0, "unscored": 0.0, "undefined": (np.nan, 0.0, 0.0), "short": (0.1, 1.0, 0.5)}
    made = {p: {k: numbers[kind] for k, kind in kept.items() if kind != "absent"} for p, kept in own.items()}
    keys = {kind: [(p, *k) for p, kept in own.items() for k, v in kept.items() if v == kind] for kind in ("failed", "unscored")}
    trials, scores = run(made, **keys)
    if scores.empty:
        return
    table = leaderboard(trials, scores, "ospa", vs=str(trials["pipeline"].iloc[0]))
    strict(render(table, "json"))
    for name in table.attrs["entrants"]:
        assert not {"undefined", "short"} & {kind for k, kind in own[name].items() if not _nobody(own, k)}


def _nobody(own, block):
    """Whether nobody has a value there, so that it counts for nobody."""
    return all(kept[block] in ("unscored", "undefined", "absent") for kept in own.values())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("runs") / "run"
    rng = np.random.default_rng(1)
    write(path, [values(rng, "normal", 8) for _ in range(2)], settings=2)
    table = {n: {"use": "pipeline", "tracker": {"use": "gm-phd", "transform": {"use": n}}} for n in "ab"}
    study = run_folder.read_study(path)
    entries = {n: {"table": t, "roles": {"tracker": "tracker", "tracker.transform": "transform"}} for n, t in table.items()}
    metrics = {m: {"use": "ospa", "c_m": 1.0} for m in study["metrics"]}
    run_folder.prepare(path, study | {"entries": entries, "metric_tables": metrics}, {})
    return path


def sonobench(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        main([str(a) for a in arguments])
    return caught.value.code, capsys.readouterr()


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--by", "snr_db", "--vs", "a"),
        ("--by", "scene", "--with", "m1"),
        ("--metric", "m0", "--metric", "m1"),
        ("--attribute", "transform"),
        ("--attribute", "transform", "--by", "snr_db", "--metric", "m1", "--metric", "m0"),
        ("--reference", "chen2012", "--by", "snr_db"),
    ],
)
def test_the_command_prints_valid_json_of_every_kind_of_board(folder, capsys, options):
    code, streams = sonobench(capsys, "board", folder, "--json", *options)
    data = strict(streams.out)
    assert code == 0
    assert len(data if isinstance(data, list) else [data]) == max(1, options.count("--metric"))


def test_several_metrics_are_one_table_as_csv_and_parquet(folder, capsys, tmp_path):
    _, streams = sonobench(capsys, "board", folder, "--format", "csv", "--metric", "m0", "--metric", "m1")
    assert pd.read_csv(io.StringIO(streams.out))["metric"].tolist() == ["m0", "m0", "m1", "m1"]
    sonobench(capsys, "board", folder, "--format", "parquet", "-o", tmp_path / "b.parquet", "--metric", "m1", "--metric", "m0")
    assert pd.read_parquet(tmp_path / "b.parquet")["metric"].tolist() == ["m1", "m1", "m0", "m0"]


def test_a_run_named_twice_is_one_run_and_its_copy_too(folder, capsys, tmp_path):
    import shutil

    copy = shutil.copytree(folder, tmp_path / "copy")
    once = sonobench(capsys, "board", folder)[1].out
    assert sonobench(capsys, "board", folder, folder)[1].out == once
    assert sonobench(capsys, "board", folder, copy)[1].out == once


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--attribute", "transfrom"), "did you mean 'transform'?"),
        (("--attribute", "tracker", "--with", "a"), "--with and --reference belong to a leaderboard"),
        (("--reference", "chen2021"), "did you mean 'chen2012'?"),
        (("--reference", "nowhere.toml"), "no such file"),
        (("--vs", "c"), "no pipeline 'c'"),
        (("--by", "snr"), "no such column"),
    ],
)
def test_what_cannot_be_boarded_ends_in_one_message_and_exit_code_2(folder, capsys, options, said):
    code, streams = sonobench(capsys, "board", folder, *options)
    assert (code, streams.out) == (2, "")
    assert said in streams.err


def test_a_reference_that_a_study_names_and_that_has_gone_is_a_note(folder):
    study = run_folder.read_study(folder)
    run = open_run(folder)
    run.studies[0]["study"]["reference"] = ["./gone.toml", "chen2012"]
    board = run.board()
    assert "ref.chen2012" in board
    assert any(note.startswith("./gone.toml cannot be read here: ") for note in board.attrs["notes"])
    assert study["study"].get("reference") is None
