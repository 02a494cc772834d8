"""Poses: hypotheses, refinement, verification, the verdict."""
