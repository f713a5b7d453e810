"""Energy: what a camera draws, what a slot of it costs, what it may spend; meters of all of it."""
