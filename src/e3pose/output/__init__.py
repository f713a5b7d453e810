"""Output of a store or a replay: files for other tools, a report page."""
