"""What everything speaks in: skeletons, poses, noise, the record of a slot."""
