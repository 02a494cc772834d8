"""The check that conftest.py puts around every function of the package."""

from __future__ import annotations

from beartype import BeartypeConf, beartype

# The numeric tower: an int is fine where a float is asked for, as it is to mypy.
checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
