"""Several motion models of one state, between which targets switch: a Markov chain of modes beside the state.

Time in a mode is exponential, so that the chain exists for every dt_s: p(dt_s) = expm(G dt_s). A target first switches, then moves by
the model that it has switched to. Particles carry their mode; Gaussians branch into one of each mode (`branches`), and components
that merge within a mode are the interacting multiple model filter. `moments` are those of all branches together.
Source: Blom & Bar-Shalom 1988, "The interacting multiple model algorithm for systems with Markovian switching coefficients"; McGinnity &
Irwin 2000, "Multiple model bootstrap filter for maneuvering target tracking" (particles); Pasha, Vo, Tuan & Ma 2009, "A Gaussian mixture
PHD filter for jump Markov system models".
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from sonobench.filtering.gaussian import symmetric
from sonobench.filtering.steps import adapts
from sonobench.protocols import Motion, State
from sonobench.types import Array, Ints, Space
from sonobench_plugins.motion.constant_velocity import ConstantVelocity


@dataclass(frozen=True)
class Imm:
    """Interacting multiple models; modes count through the models in order, and through the modes of each."""

    models: tuple[Motion, ...] = (
        ConstantVelocity(velocity_walk_m_s=0.1),
        ConstantVelocity(velocity_walk_m_s=1.0),
    )  #: of one state space, one mode each
    stay_s: float = 10.0  #: mean time in a mode; the next is any other, equally probable
    rates_hz: tuple[tuple[float, ...], ...] | None = (
        None  #: rate of switches from row to column (the diagonal is not read), in place of stay_s
    )

    def __post_init__(self) -> None:
        if not self.models:
            raise ValueError("models is empty; an imm mixes at least one motion model")
        spaces = [m.space for m in self.models]
        if any(s != spaces[0] for s in spaces):
            raise ValueError(f"the models of an imm need one state space; they have {[list(s.names) for s in spaces]}")
        nested = [type(m).__name__ for m in self.models if m.n_modes != 1]
        if nested:
            raise ValueError(f"the models of an imm have one mode each; {nested} have more: list their models instead")
        learning = [type(m).__name__ for m in self.models if adapts(m)]
        if learning:
            raise ValueError(
                f"the models of an imm would never learn from updates, for which {learning} are made: list models that do not adapt"
            )
        if not self.stay_s > 0:
            raise ValueError(f"stay_s is {self.stay_s}; above 0 is needed (inf: nobody switches)")
        if self.rates_hz is not None:
            rates = np.array([[*row] for row in self.rates_hz], dtype=object)
            n = self.n_modes
            if rates.shape != (n, n) or not all(0 <= float(r) < math.inf for r in rates[~np.eye(n, dtype=bool)]):
                raise ValueError(f"rates_hz is {self.rates_hz}; {n} rows of {n} rates of at least 0 are needed")

    @property
    def space(self) -> Space:
        """That of the models."""
        return self.models[0].space

    @property
    def n_modes(self) -> int:
        """As many as models."""
        return len(self.models)

    def transition(self, dt_s: float) -> Array:
        """Probability (n_modes, n_modes) that a target in the mode of the row is in the mode of the column dt_s later."""
        n = self.n_modes
        if n == 1:
            return np.ones((1, 1))
        if self.rates_hz is None:
            other = -math.expm1(-n * dt_s / ((n - 1) * self.stay_s)) / n
            return np.full((n, n), other) + (1 - n * other) * np.eye(n)
        from scipy.linalg import expm

        G = np.array(self.rates_hz, float)
        np.fill_diagonal(G, 0.0)
        return np.asarray(expm((G - np.diag(G.sum(axis=1))) * dt_s))

    def branches(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array, Array]:
        """Of Gaussians (n, d), (n, d, d): probability (n, n_modes) of each next mode, and the moments (n, n_modes, …) by each."""
        moved = [model.moments(x, P, np.zeros_like(mode), dt_s) for model in self.models]
        return self.transition(dt_s)[mode], np.stack([m for m, _ in moved], axis=1), np.stack([C for _, C in moved], axis=1)

    def moments(self, x: Array, P: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Array]:
        """Means and covariances of all branches together."""
        p, m, C = self.branches(x, P, mode, dt_s)
        off = self.space.residual(m, m[:, :1])
        step = np.einsum("nj,njd->nd", p, off)
        off = off - step[:, None]
        mean = m[:, 0] + step
        return mean - self._turns(mean), symmetric(np.einsum("nj,njab->nab", p, C + off[..., :, None] * off[..., None, :]))

    def sample(self, rng: np.random.Generator, x: Array, mode: Ints, dt_s: float, memory: State = None) -> tuple[Array, Ints]:
        """Switch, then move by the new mode's model."""
        edges = np.cumsum(self.transition(dt_s), axis=1)[:, :-1]
        after = (rng.random(len(x))[:, None] > edges[mode]).sum(axis=1).astype(np.int64)
        moved = np.array(x, float)
        for k, model in enumerate(self.models):
            own = after == k
            if own.any():
                moved[own] = model.sample(rng, x[own], np.zeros(int(own.sum()), np.int64), dt_s)[0]
        return moved, after

    def log_density(self, x1: Array, x0: Array, mode: Ints, dt_s: float, memory: State = None) -> Array:
        """log Σ over next modes (n,); a sum of densities, where the models' noises have one support."""
        with np.errstate(divide="ignore"):
            log_p = np.log(self.transition(dt_s)[mode])
        logs = log_p + np.stack([model.log_density(x1, x0, np.zeros_like(mode), dt_s) for model in self.models], axis=1)
        return np.asarray(np.logaddexp.reduce(logs, axis=1))

    def _turns(self, x: Array) -> Array:
        """What brings periodic coordinates back into their range."""
        return x - self.space.residual(x, np.zeros_like(x))
