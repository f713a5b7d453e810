"""What a site, or the machine of a camera, lacks before it runs, and what to do about it."""
