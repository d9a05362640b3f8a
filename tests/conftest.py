"""What all tests need, wherever they run."""

from __future__ import annotations

import signal

import pytest

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell's background job: what tests start could not be interrupted
    signal.signal(signal.SIGINT, signal.default_int_handler)

_LONG = ("test_main_job", "test_readme", "test_dask_engine")  # a module stays on one worker


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The longest first, so that no worker is left alone with them at the end."""
    items.sort(key=lambda item: not any(name in item.nodeid for name in _LONG))
