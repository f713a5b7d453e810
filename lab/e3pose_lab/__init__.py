"""What measures, reproduces and trains e3pose: needed at no site.."""
