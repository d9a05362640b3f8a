"""Likelihoods of fields."""
