"""Many scans at once: from clouds in any order and pose to one merged cloud."""
