"""The multi-Bernoulli filter of particles on a superposed signal: as many targets as fields say, without labels.

A union of independent targets, each with a probability of existence and particles. Where a scan's likelihood is a product over targets, the
multi-Bernoulli form is kept exactly, each target by itself: r ← r η / (1 − r + r η), and there is nothing to balance: that is what the filters
named CBMeMBer and Cum-CBMeMBer do with a spectrum. It is the recursion of `field-lmb`, which this component runs, without its names: who
was who in the last scan is not told. The number reported is the likeliest, and those of highest existence are.
Source: Vo, Vo, Pham & Suter 2010, "Joint detection and estimation of multiple objects from image observations", IEEE Trans. Signal Processing
58; Vo, Vo & Cantoni 2009, "The cardinality balanced multi-target multi-Bernoulli filter and its implementations", for the prediction.
Deviations: of two targets that share a peak the less probable goes, where the source joins them.
The update of detections, where cardinality must be balanced, is `gm-cbmember`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field

import numpy as np

from sonobench.filtering.steps import refuse_adaptive
from sonobench.protocols import Birth, Likelihood, Measurement, Motion
from sonobench.types import Estimate, Scan, Setup, Space
from sonobench_plugins.birth.room import Room
from sonobench_plugins.likelihood.tdoa_field import TdoaField
from sonobench_plugins.motion.constant_velocity import ConstantVelocity
from sonobench_plugins.tracker.field_lmb import FieldLmb, FieldLmbState


@dataclass(frozen=True)
class CbMember:
    """Multi-Bernoulli filter of particles on fields; the motion may have several modes."""

    motion: Motion = field(default_factory=ConstantVelocity)  #: how targets move; an imm, for several models
    likelihood: Likelihood = field(default_factory=TdoaField)  #: what fields say of one target
    birth: Birth = field(default_factory=Room)  #: where targets appear; each component is a target that may begin
    measurement: Measurement | None = None  #: what the birth asks about detections; None: it only asks which sensors there are
    p_s: float = 0.99  #: probability that a target survives one period (a scan, where scans have no period)
    particles: int = 500  #: of each target
    prune_existence: float = 0.01  #: targets that exist less probably are dropped
    merge_distance: float = 2.0  #: targets whose places differ by less than this many of their own deviations are one (0: never)
    most_targets: int = 16  #: the most probable that are kept, at most 20

    def __post_init__(self) -> None:
        self._filter()

    def _filter(self) -> FieldLmb:
        return FieldLmb(
            motion=self.motion,
            likelihood=self.likelihood,
            birth=self.birth,
            measurement=self.measurement,
            p_s=self.p_s,
            particles=self.particles,
            prune_existence=self.prune_existence,
            merge_distance=self.merge_distance,
            most_labels=self.most_targets,
            report="cardinality",
        )

    @property
    def space(self) -> Space:
        """The motion model's."""
        return self.motion.space

    def init(self, rng: np.random.Generator, setup: Setup) -> FieldLmbState:
        """Nobody, or whom the birth knows of, at the setup's start.

        Raises:
            SetupError: a model does not fit the setup or this filter.
        """
        refuse_adaptive(self.motion, "cbmember")
        return self._filter().init(rng, setup)

    def step(self, rng: np.random.Generator, state: FieldLmbState, scan: Scan) -> tuple[FieldLmbState, Estimate]:
        """Predict, give birth, update, merge, prune, extract, resample."""
        after, estimate = self._filter().step(rng, state, scan)
        return after, dataclasses.replace(estimate, labels=None, info={"targets": len(after.tracks.r)})
