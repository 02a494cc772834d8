"""Where a known model stands in a scan."""
