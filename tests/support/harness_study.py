"""A small study on disk: measurement-level scenes, and a plugin file with trackers that keep and break every rule."""

from __future__ import annotations

from pathlib import Path

PLUGIN = '''
import ctypes, os, subprocess, sys, threading, time
from dataclasses import dataclass
import numpy as np
from sonobench import Estimate, Series, Space, hookimpl

SPACE = Space(("x_m", "y_m"))


@dataclass(frozen=True)
class Guess:
    """A random walk about a point: its result depends on its generator."""

    x_m: float = 2.0
    y_m: float = 1.5
    spread_m: float = 0.1
    space = SPACE

    def init(self, rng, setup):
        return np.array([self.x_m, self.y_m])

    def step(self, rng, state, scan):
        state = state + self.spread_m * rng.standard_normal(2)
        return state, Estimate(scan.time_s, state[None])


@dataclass(frozen=True)
class Bad:
    """Breaks in the way it is told, at its second scan."""

    how: str
    space = SPACE

    def init(self, rng, setup):
        return 0

    def step(self, rng, state, scan):
        if state == 1:
            getattr(self, "_" + self.how)(scan)
        if self.how == "nan" and state == 1:
            return state + 1, Estimate(scan.time_s, np.full((1, 2), np.nan))
        if self.how == "shape" and state == 1:
            return state + 1, Estimate(scan.time_s, np.zeros((1, 5)))
        return state + 1, Estimate(scan.time_s, np.zeros((0, 2)))

    def _nan(self, scan): pass
    def _shape(self, scan): pass
    def _raise(self, scan): raise RuntimeError("as told")
    def _abort(self, scan): os.abort()
    def _exit(self, scan): os._exit(0)
    def _quit(self, scan): sys.exit(0)
    def _hang(self, scan): time.sleep(1000)
    def _child(self, scan):
        subprocess.Popen(["sleep", "999"], start_new_session=True)
        time.sleep(1000)
    def _grandchild(self, scan):
        subprocess.run(["sh", "-c", "setsid sleep 999 &"], check=True)
        time.sleep(1000)
    def _gil(self, scan): ctypes.PyDLL(None).sleep(1000)
    def _hog(self, scan):
        self_kept = [np.ones(2_000_000) for _ in range(30)]
        time.sleep(5)
    def _thread(self, scan): threading.Thread(target=time.sleep, args=(999,), daemon=True).start()
    def _orphan(self, scan): subprocess.Popen(["sleep", "999"], start_new_session=True)
    def _odd(self, scan): raise RuntimeError("a name from a disk: \\udcff " + 10_000_000 * "x")
    def _flood(self, scan):
        for _ in range(3000):
            print("x" * 1000)
            os.write(2, b"y" * 1000)


@dataclass(frozen=True)
class Distance:
    """Mean distance of the first estimate to the first target."""

    better_at_zero: bool = True

    def evaluate(self, truth, output, space):
        values = np.array([np.hypot(*(e.states[0] - truth.position[0, 0, :2])) if len(e.states) else 9.0 for e in output] or [9.0])
        return {"": Series(values, np.ones(len(values)), "m")}


@dataclass(frozen=True)
class Raising:
    def evaluate(self, truth, output, space):
        raise ValueError("a metric's own fault")


def _pipeline(how):
    return {"use": "pipeline", "front_end": {"use": "recorded"}, "tracker": {"use": "bad", "how": how}}


@hookimpl
def sonobench_components():
    hows = ("nan", "shape", "raise", "abort", "exit", "quit", "hang", "child", "grandchild", "gil", "hog", "flood", "thread", "orphan", "odd")
    return {
        "tracker": {"guess": Guess, "bad": Bad, "elsewhere": "no_such_package:Tracker"},
        "metric": {"distance": Distance, "raising": Raising},
        "pipeline": {
            "guesser": {"use": "pipeline", "front_end": {"use": "recorded"}, "tracker": {"use": "guess"}},
            "absent": {"use": "pipeline", "front_end": {"use": "recorded"}, "tracker": {"use": "elsewhere"}},
            **{how: _pipeline(how) for how in hows},
        },
    }
'''

SCENE = """
simulator = { use = "measurements", p_d = 0.9, delay_std_s = 2e-5, clutter_per_scan = 1.0 }
duration_s = 1.0
period_s = 0.1
[room]
size_m = [4.0, 3.0, 2.5]
reflections = [0.5, 0.5, 0.5, 0.5, 0.5, 0.5]
[arrays.wall]
elements_m = [[0.1, 1.0, 1.5], [0.1, 2.0, 1.5], [2.0, 0.1, 1.5]]
pairs = [[0, 1], [1, 2]]
[sources.anna]
trajectory = { use = "still", position_m = [2.0, 1.5, 1.5] }
"""

STUDY = """
plugins = ["plugin.py"]
scenes = ["one.toml", "two.toml"]
repetitions = 2
metrics = ["distance"]
[pipelines]
guesser = {}
"""


def write_study(folder: Path, study: str = STUDY, plugin: str = PLUGIN) -> Path:
    """The study's file in `folder`, with its plugin and scenes beside it."""
    (folder / "plugin.py").write_text(plugin)
    (folder / "one.toml").write_text(SCENE)
    (folder / "two.toml").write_text(SCENE.replace("duration_s = 1.0", "duration_s = 1.5"))
    path = folder / "tiny.toml"
    path.write_text(study)
    return path
