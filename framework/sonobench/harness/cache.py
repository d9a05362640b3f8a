"""The cache folder: rendered recordings and what they took, front ends' scans, compiled code. Always deletable, shared by any number of runs."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import Any

from sonobench.errors import InputError
from sonobench.files import replace_file, temporaries

_DAY_S = 86400.0
SCANS_BUDGET = 4_000_000_000  # bytes of scans that are kept; what does not fit is made again: the same bits


@dataclass(frozen=True, slots=True)
class Cache:
    """Paths below a root; every file in them is there whole or not at all."""

    root: Path

    @classmethod
    def default(cls, environment: Mapping[str, str] = os.environ) -> Cache:
        """$SONOBENCH_CACHE, else the user's cache folder (made when something is first put there)."""
        if set_by_user := environment.get("SONOBENCH_CACHE"):
            return cls(Path(set_by_user).expanduser().resolve())
        import platformdirs

        return cls(Path(platformdirs.user_cache_dir("sonobench", appauthor=False)))

    def recording(self, key: str) -> Path:
        """A rendered recording."""
        return self._folder("recordings") / f"{key}.mcap"

    def scans(self, key: str) -> tuple[Path, Path]:
        """A front end's scans, and the notes beside them (what they cost), written last."""
        folder = self._folder("scans")
        return folder / f"{key}.npz", folder / f"{key}.json"

    def has_scans(self, key: str, session: str) -> bool:
        """Whether scans are there that this session may use."""
        return self.notes(self.scans(key)[1], session) is not None

    @staticmethod
    def notes(path: Path, session: str) -> dict[str, Any] | None:
        """What stands beside a cached file, None where it must not be used: an open step's product serves its own session alone."""
        try:
            found: dict[str, Any] = json.loads(path.read_text("utf-8"))
        except (OSError, ValueError):
            return None
        return found if not found.get("beyond") or found.get("session") == session else None

    def keep_cost(self, scene: str, simulator: str, per_s: float) -> None:
        """What rendering a scene took: seconds for a second of sound; the last time counts.

        Args:
            scene, simulator: digests of what was rendered, and of the simulator's table.
        """
        replace_file(self._folder("costs") / f"{scene[:32]}.json", json.dumps({"simulator": simulator, "per_s": per_s}).encode())

    def costs(self) -> tuple[dict[str, float], dict[str, float]]:
        """What renderings took, in seconds for a second of sound: by scene (32 digits of its digest), and the mean by simulator."""
        scenes: dict[str, float] = {}
        simulators: dict[str, list[float]] = {}
        for path in (self.root / "costs").glob("*.json"):
            with suppress(OSError, ValueError, TypeError, KeyError):
                found = json.loads(path.read_text("utf-8"))
                scenes[path.stem] = float(found["per_s"])
                simulators.setdefault(found["simulator"], []).append(scenes[path.stem])
        return scenes, {name: fmean(values) for name, values in simulators.items()}

    def numba(self, digest: str) -> Path:
        """Machine code compiled from sources with this digest."""
        return self._folder("numba") / digest[:16]

    def trim_scans(self, budget: int) -> None:
        """Throw away the scans that were used longest ago, until the rest fits."""
        files = []
        for path in self._folder("scans").glob("*.npz"):
            with suppress(FileNotFoundError):  # another run trims at the same time
                stat = path.stat()
                files.append((stat.st_mtime_ns, stat.st_size, path))
        total = sum(size for _, size, _ in files)
        for _, size, path in sorted(files):
            if total <= budget:
                return
            path.with_suffix(".json").unlink(missing_ok=True)
            path.unlink(missing_ok=True)
            total -= size

    def sweep(self) -> None:
        """Remove what processes that were killed a day ago or earlier had half written; other runs may be writing now."""
        for name in ("recordings", "scans", "costs"):
            for path in temporaries(self._folder(name)):
                with suppress(FileNotFoundError):
                    if time.time() - path.stat().st_mtime > _DAY_S:
                        path.unlink()

    def _folder(self, name: str) -> Path:
        folder = self.root / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"the cache folder {folder} cannot be made: {error.strerror}; name another in SONOBENCH_CACHE") from None
        return folder
