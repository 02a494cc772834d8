"""Pairs with a known pose: shapes, benchmark protocols, a virtual depth camera."""
