"""Every call of the package in the test run is checked against its types and tensor shapes."""

from __future__ import annotations

from jaxtyping import install_import_hook

install_import_hook("fullturn", "type_checks.checked")
