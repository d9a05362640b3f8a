"""Leaderboards: statistics (NumPy), tables (pandas) and how they are printed."""

from sonobench.board.attribution import attribution
from sonobench.board.printed import beside
from sonobench.board.rendering import as_data, render
from sonobench.board.runs import same_entries, together
from sonobench.board.shards import absent, noted, refuse_two_parts
from sonobench.board.table import leaderboard

__all__ = [
    "absent",
    "as_data",
    "attribution",
    "beside",
    "leaderboard",
    "noted",
    "refuse_two_parts",
    "render",
    "same_entries",
    "together",
]
