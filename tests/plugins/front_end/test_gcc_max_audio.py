"""What the highest point of a correlation is worth in the rooms of Chen et al. 2012; docs/papers/chen2012-audio.md has the figures."""

from __future__ import annotations

import numpy as np
import pytest
from audio_hits import Plain, errors, heard_apart, heard_together

from sonobench.registry import Registry
from sonobench.scene.scene import Scene
from sonobench_plugins.front_end.gcc_max import GccMax

FRONT_ENDS = {
    "phat, hann": GccMax(),
    "phat, rectangular": GccMax(window="rectangular"),
    "plain, hann": GccMax(delay=Plain()),
    "phat, hann, 64 ms": GccMax(frame_s=0.064),
}
SEEDS = 8


def _row(what: str, error: np.ndarray) -> float:
    """Print what share of `error` (k, talkers, P) is within a tolerance of some talker; return it for one sample."""
    shares = []
    for tolerance_us in (31.25, 125.0):
        near = np.abs(error) <= tolerance_us * 1e-6  # False for NaN
        hit, joint = near.any(axis=1), near.all(axis=2).any(axis=1)
        std_us = 1e6 * np.sqrt(np.mean(np.nanmin(np.abs(error), axis=1)[hit] ** 2))
        pairs = " ".join(f"{p:.2f}" for p in hit.mean(axis=0))
        found = f"{hit.mean():.3f} (pairs {pairs}; all four of one talker {joint.mean():.3f})"
        print(f"{what}: {tolerance_us:g} us: {found}, rms of hits {std_us:.0f} us, {len(hit)} frames")
        shares.append(float(hit.mean()))
    return shares[0]


@pytest.mark.study
@pytest.mark.parametrize("t60_s", [0.2, 0.25, 0.3, 0.35, 0.4])
def test_the_highest_point_of_a_short_frame_is_mostly_wrong(t60_s):
    scene = Scene.load("chen2012-audio-isolated", Registry.load(), {"room.t60_s": t60_s})
    apart: dict[str, list[np.ndarray]] = {name: [] for name in FRONT_ENDS}
    together: dict[str, list[np.ndarray]] = {name: [] for name in FRONT_ENDS}
    for seed in range(SEEDS):
        made = scene.simulate(seed)
        parts, (header, mixed) = list(heard_apart(made)), heard_together(made)
        for name, front_end in FRONT_ENDS.items():
            for source, own, blocks in parts:
                error = errors(front_end, scene, own, blocks)[:, [list(scene.sources).index(source)]]
                apart[name].append(error[np.isfinite(error[:, 0, 0])])
            together[name].append(errors(front_end, scene, header, mixed))
    for name in FRONT_ENDS:
        alone = _row(f"T60 {t60_s} s, {name}, isolated", np.concatenate(apart[name]))
        _row(f"T60 {t60_s} s, {name}, mixed", np.concatenate(together[name]))
        assert 0.05 < alone < 0.6
