"""Trials and runs."""

from sonobench.harness.run import Run, open_run, run_study

__all__ = ["Run", "open_run", "run_study"]
