"""What every component must be: a value that pickles, prints and comes back from its table."""

from __future__ import annotations

import pickle
import re
from typing import Any

from sonobench.components import build, canonical_json, to_table
from sonobench.protocols import ROLES
from sonobench.testing.kit import Case, broken, claim, need

_ADDRESS = re.compile(r"0x[0-9a-fA-F]{6,}")
_LONG = 4000


@claim("pickled", ROLES)
def pickled(case: Case) -> None:
    """A component survives pickling, so that a worker can have it."""
    name = type(case.component).__name__
    try:
        again = pickle.loads(pickle.dumps(case.component))
    except Exception as error:
        broken(
            f"{name} cannot be pickled ({type(error).__name__}: {error}); define its class at the top of a module, hold only plain parameters"
        )
    need(type(again) is type(case.component), f"{name} comes out of pickling as {type(again).__name__}")


@claim("printed", ROLES)
def printed(case: Case) -> None:
    """A component prints its parameters: briefly, the same in every process."""
    text = repr(case.component)
    need(not _ADDRESS.search(text), f"repr is {text[:120]!r}, which holds a memory address; let the dataclass write its own repr")
    need(
        len(text) <= _LONG,
        f"repr has {len(text)} characters; at most {_LONG} are read by anybody (hide a large field with field(repr=False))",
    )


@claim("table", ROLES)
def table(case: Case) -> None:
    """A component's table builds the component again."""
    full = to_table(case.component, case.registry)
    again = to_table(build(type(case.component), full, case.registry), case.registry)
    need(
        canonical_json(again) == canonical_json(full),
        f"its table {_first_difference(full, again)} after building from it; keep the fields as they came and derive other values where they are used",
    )


def _first_difference(before: dict[str, Any], after: dict[str, Any]) -> str:
    name = next((k for k in before if canonical_json(before[k]) != canonical_json(after.get(k))), "")
    return f"says {name} = {before.get(name)!r}, and {after.get(name)!r}"
