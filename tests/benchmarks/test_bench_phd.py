"""The GM-PHD step beside Stone Soup's on the shipped scene `chen2012`: four pairs, three talkers, seven false vectors a scan.

Renderings' scans are replayed through the front end `recorded`. Both filters are the cubature PHD filter with the same births
(the paper's), p_S, p_D, motion, noise, clutter density, pruning weight, merging distance and cap. Extraction is the same too,
each component above .5 once: Stone Soup caps weights at 1 where components merge, so that it cannot report one as often as its
weight rounds to. Ours does by default, and is measured with and without.
"""

from __future__ import annotations

from dataclasses import replace
from statistics import fmean, median

import numpy as np
import pytest
from bench_clock import seconds
from scipy.stats import t

from sonobench import Pipeline, Recording, Registry, Scene
from sonobench.pipeline import generator, scans_of, track
from sonobench_plugins.birth.from_detections import FromDetections
from sonobench_plugins.birth.given import Given
from sonobench_plugins.front_end.recorded import Recorded
from sonobench_plugins.measurement.tdoa import Tdoa
from sonobench_plugins.metric.ospa import Ospa
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.tracker.gm_phd import GaussianMixturePhd
from sonobench_plugins.tracker.smc_phd import ParticlePhd
from sonobench_plugins.transform.linearised import Linearised
from sonobench_plugins.transform.unscented import Unscented

SEEDS, FEW, GIVEN = range(20), 6, ("births",)
POSITION = Ospa(p=2.0, c_m=1.5)
FULL = replace(POSITION, components=("x_m", "vx_m_s", "y_m", "vy_m_s"))
BIRTH = Given(position_std_m=0.01, velocity_std_m_s=0.01, once=2)
CK_PHD = GaussianMixturePhd(birth=BIRTH, update="stacked")
ONCE = replace(CK_PHD, multiplicity=False)


@pytest.fixture(scope="module")
def recordings():
    scene = Scene.load("chen2012", Registry.load())
    return [Recording.of(scene.simulate(seed)) for seed in SEEDS]


def replayed(tracker, recording):
    """Estimates of the tracker, and milliseconds a step."""
    pipeline = Pipeline(Recorded(), tracker, GIVEN)
    setup, scans = scans_of(pipeline.front_end, recording, pipeline.given)
    out = []
    taken_s = seconds(lambda: out.extend(track(tracker, setup, scans, generator(recording.input_sha, 0))))
    return out, 1e3 * taken_s / len(scans)


def errors(results, recordings, space, metric):
    """Mean OSPA (n,) of each recording."""
    return np.array([metric.evaluate(r.truth, e, space)[""].values.mean() for r, (e, _) in zip(recordings, results, strict=True)])


def summary(results, recordings, space):
    """Figures over recordings: ms a step (median), components and OSPA (means)."""
    sizes = [e.info["components"] for estimates, _ in results for e in estimates if "components" in e.info]
    found = {
        "ms a step": median(ms for _, ms in results),
        "OSPA of positions (m)": errors(results, recordings, space, POSITION).mean(),
        "OSPA of full states": errors(results, recordings, space, FULL).mean(),
    }
    return found | ({"components": fmean(sizes)} if sizes else {})


@pytest.mark.parametrize(
    "tracker",
    [
        CK_PHD,
        replace(CK_PHD, transform=Linearised()),
        replace(CK_PHD, transform=Unscented()),
        replace(CK_PHD, birth=FromDetections()),
        replace(CK_PHD, motion=Langevin(noise="diagonal"), measurement=Tdoa(clutter_intensity="count")),
        ParticlePhd(birth=BIRTH, update="stacked"),
    ],
    ids=["ck-phd", "ek-phd", "uk-phd", "ck-phd, births from detections", "ck-phd as printed", "smc-phd"],
)
def test_six_renderings_of_a_hundred_steps(benchmark, recordings, tracker):
    recordings = recordings[:FEW]
    results = benchmark.pedantic(
        lambda: [replayed(tracker, r) for r in recordings], rounds=1 if isinstance(tracker, ParticlePhd) else 5, warmup_rounds=1
    )
    benchmark.extra_info |= summary(results, recordings, tracker.space)


def stone_soup(recording, tracker=CK_PHD):
    from phd_stone_soup import Numbers, StoneSoup

    header = recording.header.offering(GIVEN)
    setup, scans = scans_of(Recorded(), recording, GIVEN)
    bound = Tdoa().bind(tracker.space, setup)
    numbers = Numbers(
        p_s=tracker.p_s,
        p_d=header.nominal["p_d"],
        delay_std_s=header.nominal["delay_std_s"],
        clutter_density=float(np.exp(bound.log_clutter(np.zeros(4), 0))),
        prune_weight=tracker.prune_weight,
        merge_distance=tracker.merge_distance,
        max_components=tracker.max_components,
        extract_weight=tracker.extract_weight,
    )
    memory = tracker.birth.start(tracker.space, setup, bound)
    microphones = setup.sensors[0].elements[setup.sensors[0].pairs].reshape(-1, 3)[:, :2]
    peer = StoneSoup(numbers, tracker.birth, memory, tracker.motion.matrices, microphones, setup.c_m_s)
    place = np.array([0.5, 0.0, 1.2, 0.98])
    np.testing.assert_allclose(peer.delays(place), bound.h(place, 0)[0], rtol=1e-9)
    out = []
    taken_s = seconds(lambda: out.extend(peer.run(scans, setup.start_s)))
    return out, 1e3 * taken_s / len(scans)


def paired(ours, theirs):
    """Mean difference and half its 95 % interval (Student's t over recordings)."""
    difference = ours - theirs
    return difference.mean(), t.ppf(0.975, len(difference) - 1) * difference.std(ddof=1) / len(difference) ** 0.5


def test_ours_beside_stone_soup_on_the_same_scans(benchmark, recordings):
    replayed(CK_PHD, recordings[0])
    ours, once, theirs = [], [], []
    for recording in recordings:
        ours.append(replayed(CK_PHD, recording))
        once.append(replayed(ONCE, recording))
        theirs.append(stone_soup(recording))
    benchmark.pedantic(replayed, (CK_PHD, recordings[0]), rounds=5)
    entries = {"ours": ours, "ours, each component once": once, "Stone Soup": theirs}
    found = {name: summary(results, recordings, CK_PHD.space) for name, results in entries.items()}
    benchmark.extra_info |= {f"{name}: {k}": v for name, figures in found.items() for k, v in figures.items()}
    ratios = [b / a for (_, a), (_, b) in zip(once, theirs, strict=True)]
    benchmark.extra_info |= {"times faster, median": median(ratios), "times faster, least of the renderings": min(ratios)}
    for name, results in (("ours", ours), ("ours, each component once", once)):
        for kind, metric in (("positions", POSITION), ("full states", FULL)):
            mean, half = paired(*(errors(r, recordings, CK_PHD.space, metric) for r in (results, theirs)))
            benchmark.extra_info[f"{name} less Stone Soup, OSPA of {kind}, paired 95 %"] = f"{mean:+.4f} ± {half:.4f}"
            assert mean - half <= 0
    mine, other = found["ours, each component once"], found["Stone Soup"]
    assert median(ratios) > 50
    assert 0.75 < mine["components"] / other["components"] < 1.25
    assert abs(mine["OSPA of positions (m)"] - other["OSPA of positions (m)"]) < 0.02  # the same recursion
