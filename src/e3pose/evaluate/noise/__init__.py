"""A detector's noise, measured on recordings without labels."""
