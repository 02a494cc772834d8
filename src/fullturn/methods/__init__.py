"""Registration methods, all behind one contract."""
