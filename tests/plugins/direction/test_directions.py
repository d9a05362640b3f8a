"""Direction estimators of one vector sensor: exactness, closed-form errors, the bound, two sources, literal forms."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from vector_snapshots import NOISE, SOURCE, UNEQUAL, Z, model, sample_covariances, snapshots

from sonobench.filtering.bounds import direction_information
from sonobench.geometry import angles, unit_vector
from sonobench.signal import vector_sensor as vs
from sonobench.sphere import apart
from sonobench.testing import check
from sonobench_plugins.direction.capon import Capon
from sonobench_plugins.direction.intensity import Intensity, flowing
from sonobench_plugins.direction.maximum_power import MaximumPower
from sonobench_plugins.direction.maximum_power_exact import MaximumPowerExact
from sonobench_plugins.direction.music import Music
from sonobench_plugins.direction.wpf_mp import WpfMp

_N = 8000
_TIGHT: dict[str, Any] = {"tolerance": 0.0, "iterations": 300}
SOLVERS: dict[str, Any] = {
    "intensity": flowing,
    "maximum-power": MaximumPower(alpha=0.3, **_TIGHT).solve,
    "exact": MaximumPowerExact().solve,
    "exact-diagonal": MaximumPowerExact(noise="diagonal").solve,
    "wpf-mp": WpfMp(**_TIGHT).solve,
    "wpf-mp-diagonal": WpfMp(noise="diagonal", **_TIGHT).solve,
    "capon": Capon().solve,
}


def _msae(u: Any) -> float:
    return float(np.mean(np.sum(apart(angles(u), Z) ** 2, axis=-1)))


def _bound(noise: Any, unknown: Any = "known") -> float:
    return float(np.trace(np.linalg.inv(direction_information(Z, SOURCE, np.diag(noise), _N, "gaussian", unknown))))


def _samples_of(C: Any) -> Any:
    """Frames (f, 4, 4) of four snapshots whose covariances are C (f, 4, 4)."""
    return 2.0 * np.swapaxes(np.linalg.cholesky(C), 1, 2)


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("z", [(0.5, 0.3), (np.pi, 0.0), (-2.0, -1.5), (0.0, np.pi / 2)])
def test_an_exact_covariance_gives_the_exact_direction(name: str, z: tuple[float, float]) -> None:
    u = SOLVERS[name](model(np.array(z))).u
    assert np.linalg.norm(apart(angles(u), np.array(z))) < 1e-6


#: weights of the others presume equal noise of the velocities; elsewhere their own errors count as well
_STATED = [(n, "equal") for n in SOLVERS] + [(n, "unequal") for n in SOLVERS if n not in ("maximum-power", "exact", "wpf-mp")]


@pytest.mark.parametrize(("name", "noise"), _STATED)
def test_to_first_order_directions_move_with_the_covariance_as_stated(name: str, noise: str) -> None:
    C = model(noise=UNEQUAL if noise == "unequal" else NOISE)
    change = 1e-6 * vs.symmetric(np.random.default_rng(1).standard_normal((4, 4)))
    still, there, back = SOLVERS[name](C), SOLVERS[name](C + change).u, SOLVERS[name](C - change).u
    assert np.allclose(vs.axes(still.u) @ (there - back) / 2, np.einsum("aij,ij->a", still.M, change), rtol=2e-3, atol=1e-10)


@pytest.mark.parametrize("name", SOLVERS)
def test_the_stated_covariance_is_that_of_the_errors(name: str) -> None:
    noise = UNEQUAL if "diagonal" in name else NOISE
    C = sample_covariances(np.random.default_rng(2), 6000, _N, model(noise=noise))
    one = SOLVERS[name](C)
    assert np.trace(vs.spread(one.M, C, _N).mean(axis=0)) == pytest.approx(_msae(one.u), rel=0.05)


@pytest.mark.parametrize("alpha", [0.0, 0.1, 0.25, 0.5, 0.75, 1.0])
def test_maximum_power_has_the_error_of_the_closed_form(alpha: float) -> None:
    C = sample_covariances(np.random.default_rng(3), 20000, _N, model())
    found = _msae(MaximumPower(alpha=alpha).solve(C).u) if alpha else _msae(_dominant(C))
    assert found == pytest.approx(vs.msae(alpha, SOURCE, 1.5, 0.5, _N), rel=0.03)


def _dominant(C: Any) -> Any:
    """alpha = 0: the highest eigenvector of C_vv, the sign from c_vp."""
    return MaximumPower(alpha=1e-6).solve(C).u


def test_wpf_mp_and_capon_are_within_a_hundredth_of_each_other_and_below_maximum_power_of_random_weights() -> None:
    rng = np.random.default_rng(4)
    C = sample_covariances(rng, 20000, _N, model())
    wpf, capon = (_msae(d.solve(C).u) for d in (WpfMp(), Capon()))
    alphas = rng.uniform(size=20)
    random = np.mean([_msae(MaximumPower(alpha=a).solve(part).u) for a, part in zip(alphas, np.split(C, 20), strict=True)])
    assert np.sqrt(wpf / capon) == pytest.approx(1.0, abs=0.015)
    assert max(wpf, capon) < random


@pytest.mark.parametrize("rule", ["moment", "eigen"])
def test_the_exact_maximiser_reaches_the_bound(rule: vs.Noise) -> None:
    C = sample_covariances(np.random.default_rng(5), 40000, _N, model())
    assert _msae(MaximumPowerExact(noise=rule).solve(C).u) == pytest.approx(_bound(NOISE), rel=0.02)


def test_with_unequal_noise_unwhitened_directions_are_near_the_bound_and_the_printed_ones_far_off() -> None:
    C = sample_covariances(np.random.default_rng(6), 6000, _N, model(noise=UNEQUAL))
    bound = _bound(UNEQUAL, "diagonal")
    assert np.sqrt(_msae(MaximumPowerExact(noise="diagonal").solve(C).u) / bound) == pytest.approx(1.0, abs=0.02)
    assert np.sqrt(_msae(WpfMp(noise="diagonal").solve(C).u) / bound) == pytest.approx(1.02, abs=0.03)
    for printed in (WpfMp(literal=("unnormalised", "whitened")), WpfMp(noise="diagonal", literal=("whitened",)), Capon()):
        assert np.sqrt(_msae(printed.solve(C).u) / bound) > 8


def test_whitened_weights_of_a_half_are_not_the_best_ones() -> None:
    """σ_v / (σ_p + σ_v) on the raw data: up to √2 in MSAE, where there is little signal and the velocities' noise dominates."""
    noise = np.array([0.04, 4.0, 4.0, 4.0])
    C = sample_covariances(np.random.default_rng(7), 8000, _N, model(source=0.2, noise=noise))
    raw = 2.0 / 2.2
    ratio = _msae(WpfMp(**_TIGHT).solve(C).u) / _msae(MaximumPowerExact().solve(C).u)
    assert ratio == pytest.approx(vs.msae(raw, 0.2, 0.04, 4.0, _N) / vs.msae(vs.best_alpha(noise), 0.2, 0.04, 4.0, _N), rel=0.03)


def test_capon_is_the_highest_point_of_its_spectrum_on_a_grid() -> None:
    C = sample_covariances(np.random.default_rng(8), 3, 100, model(noise=UNEQUAL))
    step = np.radians(0.1)
    for one in C:
        u = Capon().solve(one).u
        z = angles(u) + step * np.stack(np.meshgrid(np.arange(-30, 31), np.arange(-30, 31)), axis=-1).reshape(-1, 2)
        far = np.random.default_rng(9).standard_normal((2000, 3))
        grid = np.concatenate([unit_vector(z), far / np.linalg.norm(far, axis=1, keepdims=True)])
        a = np.concatenate([np.ones((len(grid), 1)), grid], axis=1)
        best = grid[np.argmin(np.einsum("gi,ij,gj->g", a, np.linalg.inv(one), a))]
        assert np.linalg.norm(apart(angles(best), angles(u))) < step


def test_a_vector_that_is_never_renormalised_forgets_the_pressure() -> None:
    """Eq. 7 as printed: the direction is that of the highest eigenvector of C_vv."""
    C = sample_covariances(np.random.default_rng(10), 50, 200, model(noise=UNEQUAL))
    u = MaximumPower(literal="unnormalised", **_TIGHT).solve(C).u
    top = np.linalg.eigh(C[:, 1:, 1:])[1][..., -1]
    assert np.allclose(np.abs(np.sum(u * top, axis=-1)), 1.0, atol=1e-3)
    assert np.abs(np.sum(MaximumPower(**_TIGHT).solve(C).u * top, axis=-1)).min() < 0.9999


@pytest.mark.parametrize("noise", ["equal", "eigen"])
def test_music_finds_two_sources_exactly_in_an_exact_covariance(noise: Any) -> None:
    where = np.radians([[30.0, 20.0], [-80.0, -10.0]])
    variances = np.full(4, 0.5) if noise == "equal" else NOISE
    C = model(where[0], 3.0, variances) + model(where[1], 1.0, np.zeros(4))
    found = Music(sources=2, noise=noise).directions(_samples_of(C[None]))
    assert found.valid.all()
    assert np.allclose(angles(found.u[0]), where, atol=1e-6)
    assert found.score is not None
    assert found.score[0, 0] == pytest.approx(3 * found.score[0, 1])


def test_music_of_two_sources_is_the_minimum_of_its_null_spectrum_and_states_its_covariance() -> None:
    where = np.radians([[30.0, 20.0], [-80.0, -10.0]])
    C = model(where[0], 3.0, np.full(4, 0.5)) + model(where[1], 1.0, np.zeros(4))
    rng = np.random.default_rng(11)
    samples = _samples_of(sample_covariances(rng, 4000, 2000, C))
    found = Music(sources=2).directions(samples)
    vectors = np.linalg.eigh(vs.covariances(samples))[1][..., :2]
    a = np.concatenate([np.ones((4000, 2, 1)), found.u], axis=-1)
    assert np.abs(np.swapaxes(vectors, 1, 2) @ np.swapaxes(a, 1, 2)).max() < 1e-9
    assert found.R is not None
    errors = apart(angles(found.u), where)
    stated = np.mean(found.R, axis=0) * 4 / 2000  # the frames hold 4 samples that stand for 2000
    for m in range(2):
        scale = np.array([np.cos(where[m, 1]), 1.0])
        assert np.allclose(np.diag(stated[m]) * scale**2, np.mean(errors[:, m] ** 2, axis=0), rtol=0.1)


def test_music_says_one_where_noise_has_pulled_two_sources_into_one() -> None:
    C = sample_covariances(np.random.default_rng(12), 400, 60, model(source=2.0, noise=np.full(4, 1.0)))
    found = Music(sources=2).directions(_samples_of(C))
    assert found.valid[:, 0].all()
    assert 0.05 < found.valid[:, 1].mean() < 0.95
    assert np.isfinite(found.u).all()
    assert np.allclose(np.linalg.norm(found.u, axis=-1), 1.0)


def test_music_of_one_source_reaches_the_intensity_at_least() -> None:
    x = snapshots(np.random.default_rng(13), 200, 500)
    assert _msae(Music().directions(x).u[:, 0]) < _msae(Intensity().directions(x).u[:, 0])


def test_parameters_that_make_no_sense_are_refused() -> None:
    for build in (lambda: MaximumPower(alpha=1.5), lambda: WpfMp(step=0.0), lambda: Music(sources=3), lambda: Capon(loading=0.0)):
        with pytest.raises(ValueError, match="needed"):
            build()


@pytest.mark.study
@pytest.mark.parametrize("alpha", [0.25, 0.5, 1.0])
def test_ten_thousand_frames_of_8000_real_snapshots_have_the_error_of_the_closed_form(alpha: float) -> None:
    rng, squares = np.random.default_rng(14), 0.0
    for _ in range(100):
        squares += 100 * _msae(MaximumPower(alpha=alpha).directions(snapshots(rng, 100, _N)).u[:, 0])
    assert squares / 10000 == pytest.approx(vs.msae(alpha, SOURCE, 1.5, 0.5, _N), rel=0.03)


def test_the_estimator_of_the_plugin_page_holds_every_claim(monkeypatch: pytest.MonkeyPatch) -> None:
    page = (Path(__file__).parents[3] / "docs" / "plugins.md").read_text("utf-8")
    (source,) = re.findall(r"```python\n(.*?class VelocityAxis.*?)```", page.split("## Vector sensors")[1], re.DOTALL)
    assert len([line for line in source.splitlines() if line.strip()]) <= 15
    module = types.ModuleType("velocity_axis")
    monkeypatch.setitem(sys.modules, "velocity_axis", module)
    exec(source, vars(module))
    findings = [f for f in check(module.VelocityAxis(), "direction") if f.check.startswith("direction.")]
    assert findings
    assert {f.sentence for f in findings if f.result != "ok"} == set()
