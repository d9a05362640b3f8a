"""Recordings, scans and estimates on disk: the only importer of mcap."""
