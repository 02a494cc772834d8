"""Classical methods of our own."""
