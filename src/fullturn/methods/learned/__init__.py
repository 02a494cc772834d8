"""The paper's network as a method."""
