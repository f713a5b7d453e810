"""Energy: power profiles, cost of a slot, budgets and virtual queues, meters."""
