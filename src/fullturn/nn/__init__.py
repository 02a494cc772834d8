"""The paper's network, from clouds to the descriptors of their points."""
