"""Data model: skeletons, poses, noise, slot records."""
