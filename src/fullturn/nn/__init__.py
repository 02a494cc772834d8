"""Networks: the paper's, and the default method's descriptors and evidence."""
