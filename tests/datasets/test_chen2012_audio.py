"""The audio versions of the chen2012 scene: the paper's geometry and walks, real speech, studies that are ready to run."""

from __future__ import annotations

import numpy as np
import pytest

from sonobench.registry import Registry
from sonobench.scene.render import emit
from sonobench.scene.scene import Scene
from sonobench.scene.study import Study
from sonobench.scene.truth import truth_of

REGISTRY = Registry.load()


@pytest.mark.parametrize("name", ["chen2012-audio", "chen2012-audio-isolated"])
def test_an_audio_scene_has_the_papers_room_pairs_walks_and_frames(name):
    paper, sound = Scene.load("chen2012", REGISTRY), Scene.load(name, REGISTRY)
    for key in ("room", "arrays", "duration_s", "period_s", "c_m_s", "given_arrays"):
        assert sound.table[key] == paper.table[key], key
    ours, theirs = truth_of(sound), truth_of(paper)
    for field in ("time_s", "position", "velocity", "exists"):
        np.testing.assert_array_equal(getattr(ours, field), getattr(theirs, field))
    assert (sound.rate_hz, sound.noise.snr_db) == (32000.0, 25.0)


def test_the_isolated_scene_differs_in_nothing_but_isolation():
    mixed, apart = (Scene.load(n, REGISTRY).table for n in ("chen2012-audio", "chen2012-audio-isolated"))
    assert {k for k in mixed if mixed[k] != apart[k]} == {"name", "about", "simulator"}
    assert {**mixed["simulator"], "isolated": True} == apart["simulator"]


def test_three_voices_talk_almost_all_the_time_and_share_a_band_of_4_khz():
    scene = Scene.load("chen2012-audio", REGISTRY)
    assert len({s.sound.clip.rsplit("-", 1)[0] for s in scene.sources.values()}) == 3
    emitted = {name: emit(scene, name, 1) for name in scene.sources}
    assert min(e.band_hz[1] for e in emitted.values()) == 4000.0
    truth = truth_of(scene, {n: (e.rate_hz, e.samples) for n, e in emitted.items()})
    assert truth.active.sum() > 0.9 * truth.exists.sum()


def test_tuning_shares_no_clip_and_no_walk_with_what_is_measured():
    measured, tuned = (Scene.load(n, REGISTRY).table["sources"].values() for n in ("chen2012-audio", "chen2012-audio-tuning"))
    assert not {s["sound"]["clip"] for s in measured} & {s["sound"]["clip"] for s in tuned}
    assert not {repr(s["trajectory"]) for s in measured} & {repr(s["trajectory"]) for s in tuned}


@pytest.mark.parametrize("name", ["", "-isolated", "-tuning", "-isolated-tuning"])
def test_an_audio_study_is_without_fault_and_measures_as_the_measurement_level_ones(name):
    study = Study.load(f"chen2012-audio{name}")
    assert study.metrics == Study.load("chen2012-t60").metrics
    assert ("scene", "room", "t60_s") in study.sweep
