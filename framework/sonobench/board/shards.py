"""Shards of a study (`run --shard 1/4`): which ones a board lacks, and doubles that are of different trials."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePath
from typing import Any

import pandas as pd

from sonobench.board.statistics import joined
from sonobench.components import canonical_json
from sonobench.errors import InputError

_Study = Mapping[str, Any]  # study.json of a run


def absent(studies: Sequence[_Study]) -> list[str]:
    """A sentence for each study of which only some shards are there; none where a run of all of it is.

    Runs are of one study where its name, seed, recordings and entries are the same; folders may differ from machine to machine.
    """
    held: dict[str, dict[int, set[int]]] = {}
    named: dict[str, str] = {}
    for study in studies:
        index, count = _part(study) or (1, 1)
        held.setdefault(whole := _whole(study), {}).setdefault(count, set()).add(index)
        named[whole] = study["study"]["name"]
    notes = []
    for whole, parts in held.items():
        if any(len(own) == count for count, own in parts.items()):
            continue
        for count, own in parts.items():
            lost = [f"{k}/{count}" for k in range(1, count + 1) if k not in own]
            verb = "is" if len(lost) == 1 else "are"
            notes.append(f"! {joined(lost)} of study {named[whole]} {verb} missing: this board is of the other shards' recordings alone.")
    return notes


def refuse_two_parts(studies: Sequence[_Study], trials: Sequence[pd.DataFrame], names: Sequence[str]) -> None:
    """One shard of one study has the same trials wherever it runs.

    Args:
        studies: study.json of each run.
        trials: its trials.
        names: of the runs, for messages.

    Raises:
        InputError: two runs hold the same shard, but other trials: a scene changed between them.
    """
    first: dict[tuple[str, Any], int] = {}
    for k, study in enumerate(studies):
        if (part := _part(study)) is None:
            continue
        other = first.setdefault((_whole(study), part), k)
        apart = set(trials[k]["trial_key"]) ^ set(trials[other]["trial_key"])
        if apart:
            raise InputError(
                f"{names[other]} and {names[k]} are both shard {part[0]}/{part[1]} of study {study['study']['name']}, but {len(apart)} trials "
                "are in one of them only: a scene changed between them; leave the older one out, or run it again"
            )


def noted(board: pd.DataFrame, notes: Sequence[str]) -> pd.DataFrame:
    """A board (or each of its groups) with further notes; the one given stays as it is."""
    attrs: dict[str, Any] = {str(k): v for k, v in board.attrs.items()}
    if "groups" in attrs:
        attrs["groups"] = [{**group, "notes": [*group["notes"], *notes]} for group in attrs["groups"]]
    else:
        attrs["notes"] = [*attrs["notes"], *notes]
    result = board.copy(deep=False)
    result.attrs.clear()
    result.attrs.update(attrs)
    return result


def _part(study: _Study) -> tuple[int, int] | None:
    """(1, 4) for "1/4"; None for all of a study."""
    if not study.get("shard"):
        return None
    index, count = str(study["shard"]).split("/")
    return int(index), int(count)


def _whole(study: _Study) -> str:
    """What the parts of a study have in common."""
    table = study["study"]
    files = {kind: [PurePath(name).name for name in table.get(kind, ())] for kind in ("scenes", "recordings")}
    own = {key: table.get(key) for key in ("name", "seed", "repetitions", "sweep")}
    entries = {name: entry["table"] for name, entry in study.get("entries", {}).items()}
    return canonical_json({**own, **files, "entries": entries})
