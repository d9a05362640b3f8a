"""Keys: what a trial, a recording, scans, estimates and scores depend on, and nothing else.

    trial_key     = H(scene or input_sha, seed, entry's name and table, run)     known when planned, free of code
    recording_key = H(scene, seed, code(scene))                                  a scene: its table and the files that it reads
    scans_key     = H(input_sha, front end, given, code(front end))
    estimate_key  = H(scans_key, tracker, code(tracker), run)
    score_key     = H(estimate_key or the failure, truth_sha, metric, code(metric))

`input_sha` is what a pipeline may read, `truth_sha` the annotations: truth never reaches an estimate's key.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from json.encoder import encode_basestring
from typing import Any


class Json(str):
    """Canonical JSON of what goes into many keys, made once: a key of it is that of the value itself."""

    __slots__ = ()

    @classmethod
    def of(cls, value: Any) -> Json:
        """Of plain data."""
        from sonobench.components import canonical_json

        return cls(canonical_json(value))


class Keys:
    """Keys of one kind that share most of their parts: canonical JSON with holes, so that each costs little more than its hash."""

    __slots__ = ("_format",)

    def __init__(self, *holes: str, **parts: Any) -> None:
        texts = {name: _text(part).replace("%", "%%") for name, part in parts.items()} | dict.fromkeys(holes, "%s")
        if list(holes) != sorted(holes):
            raise ValueError(f"holes in the order of their names are needed, got {holes}")
        self._format = "{" + ",".join(f'"{name}":{text}' for name, text in sorted(texts.items())) + "}"

    def __call__(self, *values: Any) -> str:
        """SHA-256 (first 32 hexadecimal digits) of the named parts as canonical JSON, holes filled in the order of their names."""
        return hashlib.sha256((self._format % tuple(map(_text, values))).encode()).hexdigest()[:32]


def _text(part: Any) -> str:
    if type(part) is Json:
        return part
    if type(part) is str:
        return encode_basestring(part)
    return str(part) if type(part) is int else Json.of(part)


Table = Mapping[str, Any] | Json


def trial_keys(pipeline: Table) -> Keys:
    """Names of a pipeline's planned trials, by run, seed and source: a scene's digest or a recording's input_sha."""
    return Keys("run", "seed", "source", kind="trial", pipeline=pipeline)


def recording_keys(scene: str, code: str) -> Keys:
    """Names of a scene's renderings in the cache, by seed."""
    return Keys("seed", kind="recording", scene=scene, code=code)


def scans_keys(front_end: Table, given: tuple[str, ...], code: str) -> Keys:
    """Names of a front end's output in the cache, by input_sha."""
    return Keys("input", kind="scans", front_end=front_end, given=list(given), code=code)


def estimate_keys(tracker: Table | None, code: str) -> Keys:
    """Names of a tracker's outputs, by run and scans key."""
    return Keys("run", "scans", kind="estimate", tracker=tracker, code=code)


def score_keys(metric: Table, code: str) -> Keys:
    """Names of a metric's rows, by output and truth_sha; the output is an estimate key, or says what counts as empty."""
    return Keys("output", "truth", kind="score", metric=metric, code=code)


def seed_of(*parts: str | int) -> int:
    """A seed in [0, 2^63) from strings and numbers, the same in every process."""
    return int.from_bytes(hashlib.sha256(json.dumps(parts).encode()).digest()[:8], "big") >> 1
