"""Assembly of recordings, with propagations whose result is known."""

import numpy as np
import pytest
from scene_tables import copies, registry, scene

from sonobench.errors import InputError, TableError
from sonobench.scene.reception import mixture_power
from sonobench.scene.render import assemble, emit
from sonobench.scene.resampling import resampled
from sonobench.scene.scene import Scene
from sonobench.types import identical


def mixture(rendering, array="walls"):
    return np.concatenate([b.samples for b in rendering.blocks if b.array == array])


def test_the_mixture_is_the_sum_of_what_each_source_sends():
    made = assemble(scene(), 1, copies)
    total = sum(samples for _, samples in made.sources.values())
    np.testing.assert_allclose(mixture(made), np.repeat(total[:, None], 2, 1), atol=1e-6)


def test_sound_stays_within_its_intervals_and_starts_from_silence():
    rate, samples, *_ = emit(scene(), "anna", 1)
    time = (np.arange(len(samples)) + 0.5) / rate
    inside = ((time > 0.2) & (time < 0.8)) | (time > 1.2)
    assert not samples[~inside].any()
    for edge in (1600, 9600):
        assert abs(samples[edge]) < 1e-3 < np.std(samples[edge + 80 : edge + 400])


def test_a_pause_interrupts_a_sound_instead_of_skipping_it():
    clip = {"sources": {"anna": {"sound": {"use": "clip", "clip": "ru-female-1", "offset_s": 0.5}}}}
    rate, paused, *_ = emit(scene(clip), "anna", 1)
    clip["sources"]["anna"]["intervals"] = [[0.0, 1.4]]
    _, whole, *_ = emit(scene(clip), "anna", 1)
    joined = np.concatenate([paused[1600:6400], paused[9600:]])
    inner = np.r_[100:4700, 4900:11000]  # away from the fades
    np.testing.assert_array_equal(joined[inner], whole[:11200][inner])
    assert rate == 8000


@pytest.mark.parametrize("kind", ["white", "pink"])
def test_the_noise_has_the_stated_power_against_the_active_mixture(kind):
    quiet = scene(sources={"anna": {"intervals": [[0.5, 0.9]]}, "carlo": {"intervals": [[1.0, 1.3]]}})
    noisy = scene(noise={"snr_db": 7.0, "kind": kind}, sources={"anna": {"intervals": [[0.5, 0.9]]}, "carlo": {"intervals": [[1.0, 1.3]]}})
    clean, both = mixture(assemble(quiet, 3, copies)), mixture(assemble(noisy, 3, copies))
    active = np.r_[4000:7200, 8000:10400]
    snr = np.mean(clean[active] ** 2) / np.mean((both - clean) ** 2)
    assert 10 * np.log10(snr) == pytest.approx(7.0, abs=0.15)  # 32 000 samples of noise: 0.03 dB for white
    assert np.abs(np.corrcoef((both - clean).T)[0, 1]) < 0.2


def test_mixture_power_counts_only_samples_of_intervals():
    made = scene(sources={"anna": {"intervals": [[0.5, 1.0]]}, "carlo": {"intervals": [[0.5, 1.0]]}})
    samples = np.zeros((16000, 2))
    samples[4001:8000] = 2.0
    assert mixture_power(made, samples, 8000.0) == pytest.approx(4.0, rel=1e-3)


def test_the_same_seed_gives_the_same_bits_and_another_seed_other_sounds():
    first, again, other = (assemble(scene(noise={"snr_db": 20.0}), s, copies) for s in (5, 5, 6))
    assert all(identical(a, b) for a, b in zip(first.blocks, again.blocks, strict=True))
    assert identical(first.header, again.header)
    assert identical(first.truth, again.truth)
    assert not np.array_equal(mixture(first), mixture(other))


def test_a_sounds_seed_does_not_depend_on_who_else_sounds():
    alone = scene()
    _, kept, *_ = emit(alone, "anna", 1)
    more = scene(sources={"first": {"sound": "white", "trajectory": {"use": "still", "position_m": [1.0, 1.0, 1.0]}}})
    _, again, *_ = emit(more, "anna", 1)
    np.testing.assert_array_equal(kept, again)


def test_two_sources_of_one_kind_sound_apart():
    both = scene(sources={"anna": {"sound": "white", "intervals": [[0.0, 2.0]]}, "carlo": {"sound": "white"}})
    _, one, *_ = emit(both, "anna", 1)
    _, other, *_ = emit(both, "carlo", 1)
    assert abs(np.corrcoef(one, other)[0, 1]) < 4 / np.sqrt(len(one))


def test_blocks_cover_every_array_without_gap_in_order_of_time():
    two = scene(
        arrays={"roof": {"elements_m": [[1.0, 1.0, 2.0]], "rate_hz": 16000.0}},
        duration_s=1.95,
        sources={"anna": {"intervals": [[0.2, 0.8]]}},
    )
    made = assemble(two, 1, copies)
    assert [len(mixture(made, a)) for a in ("walls", "roof")] == [15600, 31200]
    at = [b.first_sample / two.rate_of(b.array) for b in made.blocks]
    assert at == sorted(at)
    for array in two.arrays:
        mine = [b for b in made.blocks if b.array == array]
        assert [b.first_sample for b in mine[1:]] == [b.first_sample + len(b.samples) for b in mine[:-1]]


def test_arrays_of_two_rates_hear_the_same_sound():
    two = scene(arrays={"roof": {"elements_m": [[1.0, 1.0, 2.0]], "rate_hz": 16000.0}})
    made = assemble(two, 1, copies)
    slow, fast = mixture(made, "walls")[:, 0], mixture(made, "roof")[:, 0]
    np.testing.assert_allclose(slow, resampled(fast.astype(float), 16000, 8000), atol=1e-5)


def test_propagation_gets_the_path_in_the_room_and_microphones_in_the_room():
    seen = {}

    def spy(array, rate_hz, mics_m, signal, times_s, positions_m):
        seen[tuple(positions_m[0])] = (rate_hz, mics_m, times_s, positions_m)
        return copies(array, rate_hz, mics_m, signal, times_s, positions_m)

    assemble(scene(arrays={"walls": {"position_m": [0.5, 0.0, 0.0]}}), 1, spy)
    rate, mics, times, positions = seen[1.0, 1.0, 1.5]
    assert rate == 8000
    np.testing.assert_allclose(mics, [[2.3, 0.1, 1.5], [2.7, 0.1, 1.5]])
    np.testing.assert_allclose(positions[:, 0], 1 + np.maximum(times - 0.2, 0), atol=1e-12)


def test_the_band_is_what_all_sounds_have():
    clip = {"sound": {"use": "clip", "clip": "it-male-1"}}
    made = assemble(scene(rate_hz=16000.0, sources={"anna": clip}), 1, copies)
    np.testing.assert_array_equal(made.header.band_hz, [20.0, 4000.0])  # pink from 20 Hz on, the clip up to 4 kHz


def test_a_source_is_not_active_in_the_silences_of_its_sound():
    clip = {"sound": {"use": "clip", "clip": "it-male-1", "offset_s": 8.0, "pause_s": 1.0}, "intervals": [[0.0, 2.0]]}
    active = assemble(scene(sources={"anna": clip}), 1, copies).truth.active[:, 0]
    np.testing.assert_array_equal(active[[1, 2, 3]], True)
    assert not active[8:15].any()  # the clip ends after 0.71 s and begins again after 1.71 s
    assert active[18:].all()


def test_provenance_says_scene_seed_versions_and_licences():
    clip = {"sound": {"use": "clip", "clip": "it-male-1"}}
    made = assemble(scene(sources={"anna": clip}), 9, copies)
    assert made.provenance["seed"] == 9
    assert made.provenance["scene"]["sources"]["anna"]["sound"]["clip"] == "it-male-1"
    assert made.provenance["sounds"]["anna"]["licence"].startswith("CC-BY-3.0")
    assert "Carlo Flora" in made.provenance["sounds"]["anna"]["attribution"]
    assert set(made.provenance["versions"]) == {"sonobench", "numpy", "scipy"}


def test_the_header_hands_out_geometry_nominal_and_given():
    header = assemble(scene(given=["source_count"], nominal={"height_m": 1.5}), 1, copies).header
    np.testing.assert_array_equal(header.box_m, [[0, 0, 0], [4, 3, 2.5]])
    assert header.nominal == {"height_m": 1.5}
    assert set(header.given) == {"source_count"}
    assert (header.name, header.duration_s, header.arrays[0].rate_hz) == ("small@1", 2.0, 8000.0)
    assert len(set(header.reflections)) == 1


def test_vector_sensors_are_refused_where_a_simulator_does_not_know_them():
    with pytest.raises(TableError, match=r"arrays\.walls\.kind: ImageMethod renders pressure alone"):
        assemble(scene(arrays={"walls": {"kind": "avs"}}), 1, copies)


def test_a_negative_seed_and_a_wrong_propagation_are_refused():
    with pytest.raises(InputError, match="seed -1 is negative"):
        assemble(scene(), -1, copies)
    with pytest.raises(InputError, match=r"ImageMethod returned \(3, 3\) samples of anna at walls"):
        assemble(scene(), 1, lambda *_: np.zeros((3, 3)))
    with pytest.raises(InputError, match="finite"):
        assemble(scene(), 1, lambda *a: copies(*a) * np.nan)


@pytest.mark.parametrize(("own", "new"), [(8000, 16000), (16000, 8000), (44100, 16000)])
def test_resampling_keeps_tones_below_and_drops_images_above(own, new):
    low = 0.4 * min(own, new)
    time = np.arange(own) / own
    made = resampled(np.sin(2 * np.pi * low * time), own, new)
    inner = slice(new // 10, -new // 10)
    np.testing.assert_allclose(made[inner], np.sin(2 * np.pi * low * np.arange(len(made)) / new)[inner], atol=1e-3)
    if new < own:
        folded = resampled(np.sin(2 * np.pi * 0.52 * new * time), own, new)
        assert np.abs(folded[inner]).max() < 1e-3


def test_isolated_copies_add_up_to_the_mixture_and_are_what_a_scene_of_one_source_records():
    both = scene()
    mixed, apart = assemble(both, 4, copies), assemble(both, 4, copies, isolated=True)
    assert [a.name for a in apart.header.arrays] == ["walls/anna", "walls/carlo"]
    total = mixture(apart, "walls/anna") + mixture(apart, "walls/carlo")
    np.testing.assert_allclose(total, mixture(mixed), atol=1e-6)
    assert identical(apart.truth, mixed.truth)
    for name in both.sources:
        alone = Scene.from_table({**both.table, "sources": {name: both.table["sources"][name]}}, registry())
        np.testing.assert_array_equal(mixture(apart, f"walls/{name}"), mixture(assemble(alone, 4, copies)))


def test_isolated_copies_have_noise_of_their_own_against_their_own_source():
    louder = {"sources": {"carlo": {"gain_db": 12.0}}}
    clean = assemble(scene(louder), 4, copies, isolated=True)
    noisy = assemble(scene(louder, noise={"snr_db": 10.0}), 4, copies, isolated=True)
    noise = {n: mixture(noisy, n) - mixture(clean, n) for n in ("walls/anna", "walls/carlo")}
    assert abs(np.corrcoef(noise["walls/anna"][:, 0], noise["walls/carlo"][:, 0])[0, 1]) < 0.05
    for name, (first, end) in {"anna": (1600, 6400), "carlo": (0, 16000)}.items():
        power = np.mean(mixture(clean, f"walls/{name}")[first:end] ** 2)
        assert 10 * np.log10(power / np.mean(noise[f"walls/{name}"] ** 2)) == pytest.approx(10.0, abs=0.7)
