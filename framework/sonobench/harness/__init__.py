"""Trials and runs."""
