"""Point descriptors, one per file; `traits.FEATURES` lists them and what each is invariant to."""
