import numpy as np

from sonobench_plugins.activity.always import Always
from sonobench_plugins.activity.energy import Energy


def _frames(levels_db, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.standard_normal((len(levels_db), 400, 2)) * 10 ** (np.array(levels_db)[:, None, None] / 20)
    x = x.astype(np.float32)
    x.flags.writeable = False
    return x


def _run(detector, frames):
    return detector.active(detector.start(8000.0), frames)[1].tolist()


def test_voice_stands_out_of_the_pauses():
    levels = [-40] + [-60] * 4 + [-40] * 5 + [-60] * 3
    assert _run(Energy(), _frames(levels)) == [True] + [False] * 4 + [True] * 5 + [False] * 3


def test_before_a_pause_was_heard_voice_is_what_is_as_loud_as_the_first_frame():
    assert _run(Energy(), _frames([-40, -38, -42, -70, -42])) == [True, True, False, False, True]


def test_hangover_adds_exactly_that_many_frames():
    levels = [-60, -80, -60] + [-80] * 4
    assert _run(Energy(hangover_frames=2), _frames(levels))[2:] == [True, True, True, False, False]


def test_a_sound_without_pause_becomes_the_floor():
    active = _run(Energy(threshold_db=6, rise_db=0.5), _frames([-80] + [-40] * 100))
    assert active[1]
    assert not any(active[-5:])


def test_digital_silence_is_never_voice_and_teaches_no_floor():
    frames = np.concatenate([np.zeros((4, 400, 2), np.float32), _frames([-40, -60])])
    assert _run(Energy(hangover_frames=0), frames) == [False] * 4 + [True, False]


def test_memory_does_not_depend_on_how_frames_are_grouped():
    frames, detector = _frames(np.random.default_rng(1).uniform(-80, -30, 30)), Energy(hangover_frames=3)
    state, parts = detector.start(8000.0), []
    for chunk in np.split(frames, [1, 8, 9, 20]):
        state, active = detector.active(state, chunk)
        parts += active.tolist()
    assert parts == _run(detector, frames)


def test_always_is_always():
    assert _run(Always(), _frames([-300, -20])) == [True, True]
