"""Scene and study tables: physical set-ups and experiments as data, validated."""

from sonobench.scene.scene import Scene
from sonobench.scene.study import Study

__all__ = ["Scene", "Study"]
