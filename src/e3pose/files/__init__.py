"""Files: atomic writes, bounded reads, locks, versions, permissions, typed tables."""
