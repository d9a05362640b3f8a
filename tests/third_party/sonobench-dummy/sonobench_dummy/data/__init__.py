"""Scenes and pipelines of a third party."""
