"""Rigid motions, neighbors, sampling, normals and overlap: pure functions on tensors."""
