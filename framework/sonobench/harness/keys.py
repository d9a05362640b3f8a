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


def key(**parts: Any) -> str:
    """SHA-256 (first 32 hexadecimal digits) of named parts as canonical JSON."""
    text = ",".join([f'"{name}":{part if type(part) is Json else _text(part)}' for name, part in sorted(parts.items())])
    return hashlib.sha256(f"{{{text}}}".encode()).hexdigest()[:32]


def _text(part: Any) -> str:
    if type(part) is str:
        return encode_basestring(part)
    return str(part) if type(part) is int else Json.of(part)


Table = Mapping[str, Any] | Json


def trial_key(source: str, seed: int | None, pipeline: Table, run: int) -> str:
    """Name of a planned trial; `source` is a scene's digest or a recording's input_sha."""
    return key(kind="trial", source=source, seed=seed, pipeline=pipeline, run=run)


def recording_key(scene: str, seed: int, code: str) -> str:
    """Name of a rendering in the cache."""
    return key(kind="recording", scene=scene, seed=seed, code=code)


def scans_key(input_sha: str, front_end: Table, given: tuple[str, ...], code: str) -> str:
    """Name of a front end's output in the cache."""
    return key(kind="scans", input=input_sha, front_end=front_end, given=list(given), code=code)


def estimate_key(scans: str, tracker: Table | None, code: str, run: int) -> str:
    """Name of a trial's output."""
    return key(kind="estimate", scans=scans, tracker=tracker, code=code, run=run)


def score_key(output: str, truth_sha: str, metric: Table, code: str) -> str:
    """Name of a metric's rows for one output ("" is empty output, a failed trial)."""
    return key(kind="score", output=output, truth=truth_sha, metric=metric, code=code)


def seed_of(*parts: str | int) -> int:
    """A seed in [0, 2^63) from strings and numbers, the same in every process."""
    return int.from_bytes(hashlib.sha256(json.dumps(parts).encode()).digest()[:8], "big") >> 1
