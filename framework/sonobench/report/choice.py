"""Which trials are worth looking at."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sonobench.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

_ORDER = ["goodness", "scene", "repetition", "run", "trial_key"]


def choose(trials: pd.DataFrame, scores: pd.DataFrame, metric: str) -> dict[str, dict[str, str]]:
    """Keys of each pipeline's best, median and worst trial by a metric.

    Only trials that have an output count; a trial in which the metric is undefined is worse than all others. Equal
    trials stand in the order of scene and repetition. With an even number the better one of the middle is the median.

    Returns:
        {pipeline: {"best": trial_key, "median": …, "worst": …}}; pipelines without any output are left out.

    Raises:
        InputError: the run has no scores of the metric.
    """
    mine = scores[scores["metric"] == metric]
    if mine.empty:
        raise InputError(f"no scores of metric {metric!r}; the run has {sorted(set(scores['metric'])) or 'none'}")
    sign = -1.0 if mine["better"].iloc[0] == "higher" else 1.0
    values = mine["value"].abs() if mine["pool"].iloc[0] == "frame-rms" else mine["value"]
    goodness = (sign * values).groupby(mine["trial_key"]).mean()
    done = trials[trials["status"] == "ok"]
    done = done.assign(goodness=done["trial_key"].map(goodness)).sort_values(_ORDER, na_position="last")
    keys = {str(pipeline): [str(k) for k in group["trial_key"]] for pipeline, group in done.groupby("pipeline", sort=False)}
    return {pipeline: {"best": k[0], "median": k[(len(k) - 1) // 2], "worst": k[-1]} for pipeline, k in sorted(keys.items())}
