"""The Dask cluster that a run's jobs go to: one that is there, or workers on this machine for the length of the run.

Ctrl-C in a terminal goes to every process of the command. It is ours alone: workers on this machine are started with
SIGINT blocked, from their first instruction on, also those that take a dead one's place.
"""

from __future__ import annotations

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import TYPE_CHECKING

from sonobench.errors import InputError

if TYPE_CHECKING:
    from distributed import Client, LocalCluster

_ANSWER_S = 10  # for a scheduler to answer
_PATIENCE_S = 60  # for the first worker to join


@contextmanager
def connected(jobs: int, scheduler: str | None) -> Iterator[Client]:
    """A client of the scheduler at an address, or of a cluster of `jobs` workers on this machine that ends with the block.

    Raises:
        InputError: `distributed` is not installed, no scheduler answers, or it has no workers.
    """
    try:
        import dask
        from distributed import Client
    except ImportError as error:
        raise InputError(f"--engine dask: {error}; pip install 'sonobench[dask]'") from None
    settings = {
        "distributed.scheduler.allowed-failures": 0,
        "distributed.admin.system-monitor.gil.enabled": False,
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                client = Client(scheduler, timeout=_ANSWER_S, set_as_default=False)
            except (OSError, ValueError, ImportError) as error:
                raise InputError(f"--scheduler {scheduler}: no Dask scheduler answers: {error or type(error).__name__}") from None
            with client:
                yield _staffed(client, scheduler)
            return
        with _local(jobs) as cluster, Client(cluster, set_as_default=False) as client:
            yield _staffed(client, "the local cluster")


@contextmanager
def _local(jobs: int) -> Iterator[LocalCluster]:
    from distributed import LocalCluster

    resource_tracker.ensure_running()  # it starts before the first worker does, and unblocks SIGINT in the thread that starts it
    with _blocked():
        cluster = LocalCluster(
            n_workers=jobs, threads_per_worker=1, memory_limit=None, dashboard_address=":0", silence_logs=logging.CRITICAL
        )
    with cluster:
        yield cluster


@contextmanager
def _blocked() -> Iterator[None]:
    """Threads and processes that this thread starts never get SIGINT."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _staffed(client: Client, name: str) -> Client:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE_S)
    except TimeoutError:
        raise InputError(f"{name}: no Dask worker joined within {_PATIENCE_S} s") from None
    return client
