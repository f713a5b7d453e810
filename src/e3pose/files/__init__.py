"""Files: atomic writes, bounded reads, locks, permissions, typed tables."""
