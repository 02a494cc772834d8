"""Scores of found poses against true ones."""
