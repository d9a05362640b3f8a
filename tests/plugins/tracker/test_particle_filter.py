"""The particle filter against the Kalman filter, which is exact where everything is linear and Gaussian."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest

from sonobench.errors import SetupError
from sonobench.protocols import BoundMeasurement, Focused, State
from sonobench.types import Array, Floats, Scan, Sensor, Setup, Space
from sonobench_plugins.birth.given import Given
from sonobench_plugins.birth.room import Room
from sonobench_plugins.measurement.position import Position
from sonobench_plugins.motion.adaptive_constant_velocity import AdaptiveConstantVelocity
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.motion.langevin import Langevin
from sonobench_plugins.motion.random_walk import RandomWalk
from sonobench_plugins.tracker.particle_filter import ParticleFilter
from sonobench_plugins.transform.cubature import Cubature
from sonobench_plugins.transform.linearised import Linearised

BOX_M = np.array([[0.0, 0.0, 0.0], [6.0, 5.0, 2.7]])
START = np.array([[0.0, 2.0, 1.5, 1.5, 0.8, 0.3, 0.0]])  # t, x, y, z, vx, vy, vz
SENSORS = (
    Sensor("first", "none", "position", np.zeros((1, 3)), Space.of("x_m", "y_m")),
    Sensor("second", "none", "position", np.zeros((1, 3)), Space.of("y_m")),
)
SETUP = Setup(SENSORS, ("none",), np.eye(4)[None], period_s=0.1, box_m=BOX_M, given={"starts": START})
STD_M = 0.2


@dataclass(frozen=True)
class Seen:
    """Positions in `Scan.extra` with Gaussian errors."""

    trusted: bool = True

    def bind(self, space: Space, setup: Setup) -> BoundSeen:
        model = Position(position_std_m=STD_M, p_d=1.0, clutter_per_scan=1.0).bind(space, setup)
        return BoundSeen(space, model, self.trusted)


@dataclass(frozen=True)
class BoundSeen:
    space: Space
    model: BoundMeasurement
    trusted: bool
    asked: list[int] = field(default_factory=list)

    @property
    def sensors(self) -> tuple[int, ...]:
        return (0, 1)

    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        if not scan.searched.any():
            return None
        total = np.zeros(len(x))
        for q in (0, 1):
            off = scan.extra[f"z{q}"] - self.model.h(x, q)[:, 0]
            total -= 0.5 * np.sum((off / STD_M) ** 2, axis=1)
        return total

    def focused(self, x: Floats, w: Floats, scan: Scan) -> Focused | None:
        if not scan.searched.any():
            return None
        rows = tuple((q, scan.extra[f"z{q}"], np.eye(2 - q) * STD_M**2) for q in (0, 1)) if self.trusted else ()
        return Focused(lambda at: np.asarray(self.log_ratio(at, scan)), self.model, rows)


def scan(k: int, z: Floats | None) -> Scan:
    if z is None:
        return Scan(0.1 * k, np.zeros(2, bool))
    return Scan(0.1 * k, np.ones(2, bool), extra={"z0": z[:2], "z1": z[2:]})


def kalman(scans: list[Scan], motion: ConstantVelocity) -> list[Array]:
    m, P = np.array([2.0, 0.8, 1.5, 0.3]), np.diag([0.25**2, 0.5**2, 0.25**2, 0.5**2])
    H = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, 0, 1, 0]])
    F, Q = motion.matrices(0.1)
    out = []
    for s in scans:
        m, P = F @ m, F @ P @ F.T + Q
        if s.searched.any():
            z = np.r_[s.extra["z0"], s.extra["z1"]]
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.eye(3) * STD_M**2)
            m, P = m + K @ (z - H @ m), P - K @ H @ P
        out.append(m)
    return out


def tracked(tracker: ParticleFilter, scans: list[Scan], seed: int = 1) -> list[Array]:
    rng = np.random.default_rng(seed)
    state, out = tracker.init(rng, SETUP), []
    for s in scans:
        state, estimate = tracker.step(rng, state, s)
        out.append(estimate.states[0])
    return out


def measured(gap: bool = True) -> list[Scan]:
    rng = np.random.default_rng(7)
    truth = np.array([2.0, 1.5]) + 0.1 * np.arange(1, 13)[:, None] * np.array([0.8, 0.3])
    z = np.c_[truth, truth[:, 1]] + STD_M * rng.standard_normal((12, 3))
    return [scan(k + 1, None if gap and k in (4, 5) else z[k]) for k in range(12)]


MOTION = ConstantVelocity(velocity_walk_m_s=0.7)


@pytest.mark.parametrize(
    "tracker",
    [
        ParticleFilter(MOTION, Seen(), particles=6000),
        ParticleFilter(MOTION, Seen(), particles=6000, proposal="unscented", robust="none"),
        ParticleFilter(MOTION, Seen(), particles=6000, proposal="unscented", transform=Linearised()),
        ParticleFilter(MOTION, Seen(), particles=6000, proposal="unscented", transform=Cubature(), robust="printed"),
        ParticleFilter(MOTION, Seen(trusted=False), particles=6000, proposal="unscented"),
        ParticleFilter(MOTION, Seen(), particles=6000, proposal="unscented", prior_share=0.0),
        ParticleFilter(MOTION, Seen(), particles=6000, proposal="unscented", prior_share=0.5),
    ],
    ids=["prior", "unscented", "robust", "printed", "untrusted", "alone", "half"],
)
def test_every_proposal_gives_the_kalman_filters_means(tracker: ParticleFilter) -> None:
    scans = measured()
    for own, exact in zip(tracked(tracker, scans), kalman(scans, MOTION), strict=True):
        np.testing.assert_allclose(own[[0, 2]], exact[[0, 2]], atol=0.03)
        np.testing.assert_allclose(own[[1, 3]], exact[[1, 3]], atol=0.1)


def _conditioned(robust: str, off: float) -> float:
    """How far one particle's Gaussian follows a row that is `off` away."""
    tracker = ParticleFilter(MOTION, Seen(), particles=1, proposal="unscented", robust=robust)  # type: ignore[arg-type]
    state = tracker.init(np.random.default_rng(1), SETUP)
    m, P = np.array([[2.0, 0.0, 1.5, 0.0]]), np.diag([0.1, 0.1, 0.1, 0.1])[None]
    s = scan(1, np.array([2.0 + off, 1.5, 1.5]))
    focus = state.likelihood.focused(m, np.ones(1), s)  # type: ignore[attr-defined]
    return float(tracker._conditioned(m, P, focus, state, s)[0][0, 0] - 2.0)


def test_a_large_residual_raises_the_gain_and_as_printed_lowers_it() -> None:
    plain, raised, printed = (_conditioned(r, 3.0) / 3.0 for r in ("none", "raise", "printed"))
    assert printed < plain < raised < 1.0
    assert _conditioned("raise", 0.01) == pytest.approx(_conditioned("none", 0.01))


def test_covariances_that_are_carried_widen_the_proposal_and_waste_particles() -> None:
    effective = {}
    for covariance in ("motion", "carried"):
        tracker, rng = ParticleFilter(MOTION, Seen(), proposal="unscented", covariance=covariance), np.random.default_rng(1)  # type: ignore[arg-type]
        _, estimate = tracker.step(rng, tracker.init(rng, SETUP), measured()[0])
        effective[covariance] = estimate.info["effective"]
    assert effective["carried"] < 0.2 * effective["motion"]


def test_a_share_from_the_motion_survives_rows_that_are_false() -> None:
    """Rows 1.5 m off are trusted, the likelihood knows better: only particles from the motion are where it is high."""
    found = {}
    for share in (0.0, 0.1):
        tracker, rng = ParticleFilter(MOTION, Mistaken(), particles=2000, proposal="unscented", prior_share=share), np.random.default_rng(1)
        _, estimate = tracker.step(rng, tracker.init(rng, SETUP), scan(1, np.array([2.08, 1.53, 1.53])))
        found[share] = estimate.info["effective"], abs(float(estimate.states[0][0]) - 2.08)
    assert found[0.1][0] > 5 * found[0.0][0]
    assert found[0.1][1] < 0.1 < found[0.0][1]


def test_shares_of_everything_or_less_than_nothing_are_refused() -> None:
    for share in (1.0, -0.1):
        with pytest.raises(ValueError, match="prior_share is"):
            ParticleFilter(prior_share=share)


class Mistaken(Seen):
    def bind(self, space: Space, setup: Setup) -> BoundSeen:
        return _BoundMistaken(space, super().bind(space, setup).model, True)


class _BoundMistaken(BoundSeen):
    def focused(self, x: Floats, w: Floats, scan: Scan) -> Focused | None:
        focus = super().focused(x, w, scan)
        assert focus is not None
        rows = tuple((q, z + 1.5, R * 1e-2) for q, z, R in focus.rows)
        return Focused(focus.log_ratio, focus.measurement, rows)


def test_particles_stay_in_the_room() -> None:
    wall = [scan(k, np.array([6.3, 2.0, 2.0])) for k in range(1, 40)]
    for tracker in (ParticleFilter(MOTION, Seen()), ParticleFilter(MOTION, Seen(), proposal="unscented")):
        assert all(x[0] <= BOX_M[1, 0] + 1e-9 for x in tracked(tracker, wall))


def test_weights_that_all_vanish_are_forgotten_and_said() -> None:
    tracker, rng = ParticleFilter(MOTION, Nowhere()), np.random.default_rng(1)
    state, estimate = tracker.step(rng, tracker.init(rng, SETUP), scan(1, np.zeros(3)))
    assert estimate.info["lost"] == 1.0
    assert len(state.x) == 300


class Nowhere(Seen):
    def bind(self, space: Space, setup: Setup) -> BoundSeen:
        return _BoundNowhere(space, super().bind(space, setup).model, False)


class _BoundNowhere(BoundSeen):
    def log_ratio(self, x: Floats, scan: Scan) -> Array | None:
        return np.full(len(x), -np.inf)


def test_an_adaptive_motion_gets_its_memory_back() -> None:
    rng, tracker = np.random.default_rng(1), ParticleFilter(AdaptiveConstantVelocity(), Seen())
    state = tracker.init(rng, SETUP)
    for s in measured(gap=False)[:3]:
        state, _ = tracker.step(rng, state, s)
    assert np.shape(state.memory) == (2,)


def test_a_motion_learns_over_the_time_since_the_last_update() -> None:
    asked: list[float] = []

    class Learning(AdaptiveConstantVelocity):
        def adapt(self, memory: State, prior: Array, posterior: Array, dt_s: float) -> State:
            asked.append(dt_s)
            return memory

    tracked(ParticleFilter(Learning(), Seen()), measured())  # the fifth and sixth scan are silent
    np.testing.assert_allclose(asked, [0.1] * 4 + [0.3] + [0.1] * 5)


def test_positions_alone_are_tracked_too() -> None:
    found = tracked(ParticleFilter(RandomWalk(), Seen()), measured(gap=False))
    assert np.linalg.norm(found[-1] - np.array([2.96, 1.86])) < 0.3


REFUSED: list[tuple[Callable[[], ParticleFilter], str]] = [
    (lambda: ParticleFilter(Langevin(), Seen(), proposal="unscented"), "zero but on a line"),
    (lambda: ParticleFilter(MOTION, Seen(), birth=Room()), "given"),
    (lambda: ParticleFilter(MOTION, Seen(), birth=Given("births")), "births"),
]


@pytest.mark.parametrize(("make", "words"), REFUSED)
def test_what_does_not_fit_is_refused(make: Callable[[], ParticleFilter], words: str) -> None:
    with pytest.raises(SetupError, match=words):
        make().init(np.random.default_rng(1), SETUP)


def test_an_unscented_proposal_in_several_motion_modes_is_refused() -> None:
    from sonobench_plugins.motion.imm import Imm

    models = (ConstantVelocity(velocity_walk_m_s=0.1), ConstantVelocity(velocity_walk_m_s=2.0))
    with pytest.raises(SetupError, match="one motion mode"):
        ParticleFilter(Imm(models), Seen(), proposal="unscented").init(np.random.default_rng(1), SETUP)
