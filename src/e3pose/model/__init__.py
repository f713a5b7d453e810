"""Data model: cameras and projection, skeletons, poses, noise, slot records."""
