"""`python -m sonobench.testing FILE`: the findings on a plugin file as one line of JSON, the last that is printed."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

from sonobench.errors import SonobenchError
from sonobench.testing import check_file


def main() -> int:
    """0 with the findings, 2 with the error of a file that cannot be loaded."""
    try:
        findings = check_file(Path(sys.argv[1]))
    except SonobenchError as error:
        print(json.dumps({"error": str(error)}))
        return 2
    print(json.dumps({"findings": [dataclasses.asdict(f) for f in findings]}))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
