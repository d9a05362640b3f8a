"""Recorded sounds: level, band, repetition, and files that are not sound."""

import numpy as np
import pytest
import soundfile
from scene_tables import registry

from sonobench.errors import InputError
from sonobench_plugins.sound.clip import Clip

NAMES = sorted(registry().data_files("clips", ".flac"))


def rng(seed=0):
    return np.random.default_rng(seed)


@pytest.mark.parametrize("name", NAMES)
def test_a_packaged_clip_is_mono_without_mean_and_has_its_licence_beside_it(name):
    file = Clip(name).files[0]
    samples, _ = soundfile.read(file)
    text = file.with_suffix(".txt").read_text("utf-8")
    assert samples.ndim == 1
    assert abs(samples.mean()) < 1e-3 * samples.std() + 1e-4
    assert 0.5 < np.abs(samples).max() < 1.0
    assert "License: BSD-2" in text or "License: CC-BY-3.0" in text
    assert "Copyright: " in text


def test_the_packaged_speech_is_about_a_minute_of_three_voices_in_about_a_megabyte():
    files = [Clip(n).files[0] for n in NAMES]
    assert {n.rpartition("-")[0] for n in NAMES} == {"librivox-male", "ru-female", "it-male"}
    assert 55 < sum(soundfile.info(f).duration for f in files) < 90
    assert sum(f.stat().st_size for f in files) < 1.1e6


@pytest.mark.parametrize("rate", [8000.0, 16000.0, 48000.0])
def test_active_speech_has_the_stated_level_at_any_rate(rate):
    made = Clip("it-male-1", offset_s=0.0, rms=0.05).render(rng(), 8.7, rate)
    frames = made.samples.reshape(435, -1)
    power = np.mean(frames**2, axis=1)
    assert np.sqrt(power[power > 1e-4 * power.max()].mean()) == pytest.approx(0.05, rel=0.02)


def test_the_band_is_the_lower_half_rate_and_nothing_lies_above_it():
    clip = Clip("ru-female-1", offset_s=0.0)
    assert [clip.render(rng(), 1.0, r).band_hz for r in (4000.0, 8000.0, 16000.0)] == [(0.0, 2000.0), (0.0, 4000.0), (0.0, 4000.0)]
    spectrum = np.abs(np.fft.rfft(clip.render(rng(), 6.0, 16000.0).samples * np.hanning(96000))) ** 2
    assert 10 * np.log10(spectrum[24600:].max() / spectrum.max()) < -70


def test_a_clip_repeats_after_its_pause_and_starts_where_it_is_told(tmp_path):
    soundfile.write(tmp_path / "ramp.wav", np.sin(np.arange(8000) * 0.7), 8000, subtype="FLOAT")
    one = Clip(str(tmp_path / "ramp.wav"), offset_s=0.0, pause_s=0.5).render(rng(), 4.0, 8000.0).samples
    np.testing.assert_array_equal(one[:12000], one[12000:24000])
    assert not one[8000:12000].any()
    late = Clip(str(tmp_path / "ramp.wav"), offset_s=0.25, pause_s=0.5).render(rng(), 2.0, 8000.0).samples
    np.testing.assert_array_equal(late, one[2000:18000])


def test_the_seed_chooses_where_a_clip_starts_unless_it_is_stated():
    def head(clip, seed):
        return clip.render(rng(seed), 1.0, 8000.0).samples

    np.testing.assert_array_equal(head(Clip("it-male-2"), 1), head(Clip("it-male-2"), 1))
    assert np.any(head(Clip("it-male-2"), 1) != head(Clip("it-male-2"), 2))
    np.testing.assert_array_equal(head(Clip("it-male-2", 1.0), 1), head(Clip("it-male-2", 1.0), 2))


def test_several_channels_are_mixed_down(tmp_path):
    wave = np.sin(np.arange(8000) * 0.3)
    soundfile.write(tmp_path / "mono.wav", wave, 8000, subtype="FLOAT")
    soundfile.write(tmp_path / "stereo.wav", np.stack([2 * wave, 0 * wave], 1) / 2, 8000, subtype="FLOAT")
    mono, stereo = (Clip(str(tmp_path / f"{n}.wav"), 0.0).render(rng(), 1.0, 8000.0).samples for n in ("mono", "stereo"))
    np.testing.assert_allclose(mono, stereo, atol=1e-6)


def test_what_is_no_sound_is_refused(tmp_path):
    (tmp_path / "text.wav").write_text("no sound")
    soundfile.write(tmp_path / "silence.wav", np.zeros(8000), 8000)
    soundfile.write(tmp_path / "click.wav", np.ones(10), 8000)
    for name, says in (("text", "cannot be read as sound"), ("silence", "holds no sound"), ("click", "holds no sound")):
        with pytest.raises(InputError, match=says):
            Clip(str(tmp_path / f"{name}.wav")).render(rng(), 1.0, 8000.0)
    with pytest.raises(InputError, match=r"no clip is named 'nobody'; there are it-male-1, it-male-2"):
        Clip("nobody").render(rng(), 1.0, 8000.0)
    for bad in ({"offset_s": -1.0}, {"pause_s": -1.0}, {"rms": 0.0}):
        with pytest.raises(ValueError, match="needed"):
            Clip("it-male-1", **bad)
