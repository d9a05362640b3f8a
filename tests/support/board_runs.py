"""Invented runs: trials and scores as the run folder holds them."""

from __future__ import annotations

import itertools

import pandas as pd


def run(values, metric="ospa", better="lower", pool="mean", unit="m", failed=(), unscored=(), **more):
    """Tables of a run.

    `values`: {pipeline: {(scene, repetition): value, or (value, weight, coverage), or {slice: value}}}.
    `failed`, `unscored`: (pipeline, scene, repetition) of trials that failed (their value is that of empty output), or have no score.
    """
    trials, scores = [], []
    for pipeline, blocks in values.items():
        for (scene, repetition), value in blocks.items():
            key = f"{pipeline}/{scene}/{repetition}"
            bad = (pipeline, scene, repetition) in failed
            trials.append(
                {
                    "trial_key": key,
                    "pipeline": pipeline,
                    "distribution": "sonobench",
                    "version": "0.1.0",
                    "scene": scene,
                    "repetition": repetition,
                    "run": 0,
                    "status": "error" if bad else "ok",
                    "front_end_s": None if bad else 0.02,
                    "tracker_s": None if bad else 0.08,
                    "frames": None if bad else 100,
                    "given": "",
                }
                | more
            )
            if (pipeline, scene, repetition) in unscored:
                continue
            slices = value if isinstance(value, dict) else {"": value}
            for name, entry in slices.items():
                number, weight, coverage = entry if isinstance(entry, tuple) else (entry, 1.0, 1.0)
                common = {"metric": metric, "metric_sha": "m", "unit": unit, "better": better, "pool": pool}
                scores.append({"trial_key": key, "slice": name, "value": number, "weight": weight, "coverage": coverage, **common})
    return pd.DataFrame(trials), pd.DataFrame(scores)


def grid(function, scenes, repetitions):
    """{(scene, repetition): function(scene index, repetition)}."""
    return {(f"room{s}", r): function(s, r) for s, r in itertools.product(range(scenes), range(repetitions))}
