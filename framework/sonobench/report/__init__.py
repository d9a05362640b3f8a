"""Pictures of trials."""

from sonobench.report.choice import choose
from sonobench.report.figures import pictures
from sonobench.report.run_report import write_report

__all__ = ["choose", "pictures", "write_report"]
