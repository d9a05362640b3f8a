"""Leaderboards: statistics (NumPy), tables (pandas) and how they are printed."""

from sonobench.board.rendering import render
from sonobench.board.table import leaderboard

__all__ = ["leaderboard", "render"]
