"""A plugin package on disk, found by its entry point as an installed one is, and studies with its components."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from harness_study import SCENE

from sonobench.harness.code import forget
from sonobench.harness.progress import Silent
from sonobench.harness.run import Run
from sonobench.scene.study import Study

_TRACKER = '''"""A tracker that stands where its helpers say."""
from dataclasses import dataclass
import numpy as np
from sonobench import Estimate, Space
{imports}

@dataclass(frozen=True)
class Tracker:
    """Stands still."""
    x_m: float = 1.0
    space = Space(("x_m", "y_m"))
{fields}
    def init(self, rng, setup):
        return 0

    def step(self, rng, state, scan):
        """One step."""
        x_m = self.x_m
{body}
        return state, Estimate(scan.time_s, np.array([[x_m, 1.0]]))
'''

#: imports, further lines of the class, body of `step`, by the pipeline's name
TRACKERS = {
    "plain": ("from zoo.helper import help_", "", "x_m = help_(x_m)"),
    "late": ("", "", "from zoo.late import later; x_m = later(x_m)"),
    "facade": ("import sonobench as sb", "", "x_m = x_m + 0 * len(sb.Mixture.__name__)"),
    "lazy": ("from zoo import lazily", "", "x_m = lazily(x_m)"),
    "attribute": ("import zoo", "", "x_m = zoo.lazily(x_m)"),
    "compiled": ("from zoo.fast import shared", "", "x_m = float(shared(x_m))"),
    "declared": (
        "from pathlib import Path",
        "    @property\n    def files(self): return (Path(__file__).parent / 'table.txt',)\n",
        "x_m = float(self.files[0].read_text())",
    ),
    "reading": ("from pathlib import Path", "", "x_m = float((Path(__file__).parent / 'secret.txt').read_text())"),
    "wheel": ("import stuff_of_a_wheel", "", "x_m = stuff_of_a_wheel.X"),
    "computed": ("import importlib", "", "x_m = importlib.import_module('zoo.hid' + 'den').X"),
    "top": ("import importlib\nX = importlib.import_module('zoo.bur' + 'ied').X", "", "x_m = X"),
    "clock": ("import time", "", "x_m = x_m + np.random.default_rng(time.time_ns()).normal()"),
    "shell": ("import subprocess", "", "subprocess.run(['true'])"),
    "broken": ("", "", "raise RuntimeError('a bug of mine')"),
}

FILES = {
    "__init__.py": """
_HOME = {"lazily": "laziness", "other": "stranger"}

def __getattr__(name):
    if name not in _HOME:
        raise AttributeError(name)
    import importlib
    return getattr(importlib.import_module(f"zoo.{_HOME[name]}"), name)
""",
    "helper.py": "from .deep import deep\ndef help_(x):\n    return deep(x)\n",
    "deep.py": "def deep(x):\n    return x\n",
    "late.py": "def later(x):\n    return x\n",
    "laziness.py": "def lazily(x):\n    return x\n",
    "stranger.py": "def other(x):\n    return x\n",
    "hidden.py": "X = 1.0\n",
    "buried.py": "X = 1.0\n",
    "fast.py": (
        "from numba import njit\nfrom zoo.kernels import kernel\n\n@njit(cache=True)\ndef shared(x):\n    return kernel(x) + 0.0\n"
    ),
    "kernels.py": "from numba import njit\n\n@njit(cache=True)\ndef kernel(x):\n    return x * 1.0\n",
    "table.txt": "1.0",
    "secret.txt": "1.0",
    "front.py": '''from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar
from sonobench import Setup
from zoo.noted import noted

@dataclass(frozen=True)
class Front:
    """Recorded scans, and a line in front.txt."""
    consumes: ClassVar[str] = "scans"
    def open(self, header):
        noted("front")
        return Setup.from_header(header, header.sensors, header.period_s), None
    def step(self, state, scan):
        return state, [scan]
    def flush(self, state):
        return []
''',
    "sim.py": '''from dataclasses import dataclass
from typing import ClassVar
from sonobench.protocols import Simulator
from zoo.noted import noted

@dataclass(frozen=True)
class Sim:
    """Another simulator's rendering, and a line in sim.txt."""
    of: Simulator
    needs_sound: ClassVar[bool] = False
    def simulate(self, scene, seed):
        noted("sim")
        return self.of.simulate(scene, seed)
''',
    "noted.py": """from pathlib import Path

def noted(name):
    with (Path(__file__).parent / f"{name}.txt").open("a") as file:
        file.write("once more\\n")
    look(Path(__file__).parent / "secret.txt")

def look(path):
    pass
""",
    "metric.py": '''from dataclasses import dataclass
import numpy as np
from sonobench import Series

@dataclass(frozen=True)
class East:
    """Mean x of the first estimate."""
    def evaluate(self, truth, output, space):
        values = np.array([e.states[0, 0] if len(e.states) else 9.0 for e in output])
        return {"": Series(values * 1.0, np.ones(len(values)), "m")}
''',
}


class Zoo:
    """The package below a folder, and runs of its pipelines through the public API."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.package = folder, folder / "site" / "zoo"
        self.package.mkdir(parents=True)
        trackers = {f"{name}_tracker.py": self.source(name) for name in TRACKERS}
        register = "from sonobench import hookimpl\n\n@hookimpl\ndef sonobench_components():\n    return {\n        'tracker': {"
        register += "".join(f"'{n}': 'zoo.{n}_tracker:Tracker', " for n in TRACKERS)
        register += "},\n        'metric': {'east': 'zoo.metric:East'},\n        'front_end': {'front': 'zoo.front:Front'},\n"
        register += "        'simulator': {'sim': 'zoo.sim:Sim'},\n        'pipeline': {"
        register += "".join(f"'{n}': {{'use': 'pipeline', 'front_end': 'recorded', 'tracker': '{n}'}}, " for n in TRACKERS) + "},\n    }\n"
        for name, text in {**FILES, **trackers, "_register.py": register}.items():
            (self.package / name).write_text(text)
        about = folder / "site" / "zoo-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: zoo\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text("[sonobench]\nzoo = zoo._register\n")
        wheels = folder / "site-packages"
        wheels.mkdir()
        (wheels / "stuff_of_a_wheel.py").write_text("X = 1.0\n")
        self.release("1.0")
        (folder / "one.toml").write_text(SCENE)

    @property
    def paths(self) -> list[str]:
        """What belongs on sys.path."""
        return [str(self.folder / "site"), str(self.folder / "site-packages")]

    @staticmethod
    def source(name: str) -> str:
        """A tracker's module."""
        imports, fields, body = TRACKERS[name]
        return _TRACKER.format(imports=imports, fields=fields, body="\n".join(f"        {line}" for line in body.split("\n")))

    def release(self, version: str) -> None:
        """Install that version of the wheel."""
        for old in (self.folder / "site-packages").glob("*.dist-info"):
            (old / "METADATA").unlink()
            old.rmdir()
        about = self.folder / "site-packages" / f"stuff_of_a_wheel-{version}.dist-info"
        about.mkdir()
        (about / "METADATA").write_text(f"Metadata-Version: 2.1\nName: stuff_of_a_wheel\nVersion: {version}\n")

    @classmethod
    @contextmanager
    def installed(cls, folder: Path, monkeypatch: Any) -> Iterator[Zoo]:
        """The package on sys.path, an empty cache, and `folder` the current one."""
        monkeypatch.setenv("SONOBENCH_CACHE", str(folder / "cache"))
        monkeypatch.chdir(folder)
        made = cls(folder)
        for path in made.paths:
            monkeypatch.syspath_prepend(path)
        yield made
        made.forget()

    def edit(self, name: str, old: str, new: str) -> None:
        """Change a file of the package."""
        path = self.package / name
        text = path.read_text()
        assert old in text
        path.write_text(text.replace(old, new))

    def run(self, *pipelines: str, **options: Any) -> Run:
        """Run these pipelines on one scene as a new process would: with what the files say now."""
        study = self.study(*pipelines)
        return study.run(out=self.folder / "run", **{"in_process": True, "display": Silent(), **options})

    def study(self, *pipelines: str) -> Study:
        """A study of these pipelines."""
        self.forget()
        path = self.folder / "zoos.toml"
        entries = "\n".join(f"{name} = {{}}" for name in pipelines)
        path.write_text(f'scenes = ["one.toml"]\nmetrics = ["east"]\n[pipelines]\n{entries}\n')
        return Study.load(path)

    def forget(self) -> None:
        """Import everything of the zoo anew."""
        for name in [n for n in sys.modules if n.partition(".")[0] in ("zoo", "stuff_of_a_wheel")]:
            del sys.modules[name]
        importlib.invalidate_caches()
        forget()
