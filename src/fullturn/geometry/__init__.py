"""Motions, neighbors, sampling, normals and extents: pure functions on tensors and arrays."""
