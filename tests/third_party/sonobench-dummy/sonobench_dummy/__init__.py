"""A third party's plugin: what it registers."""

import json
import os

from sonobench import hookimpl


@hookimpl
def sonobench_components():
    return {
        "delay": {"half-phat": "sonobench_dummy.delay:HalfPhat"},
        "tracker": {"best-cell": "sonobench_dummy.tracker:BestCell"},
        "pipeline": {
            "half-cell": {
                "front_end": {"use": "gcc-peaks", "delay": {"use": "half-phat", "beta": 0.7}},
                "tracker": {"use": "best-cell", "sensor": "pair-"},
            }
        },
    }


@hookimpl
def sonobench_data():
    return "sonobench_dummy.data"


@hookimpl
def sonobench_trial_finished(row):
    """Append what finished to the file that SONOBENCH_DUMMY_LOG names."""
    path = os.environ.get("SONOBENCH_DUMMY_LOG")
    if path:
        with open(path, "a", encoding="utf-8") as log:
            log.write(json.dumps({"pipeline": row["pipeline"], "status": row["status"]}) + "\n")
