"""Matches between the descriptors of two clouds."""
