"""What leaves a store or a replay: files for other tools, a report page."""
