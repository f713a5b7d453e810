"""Training the predictor: the only part of the package that needs torch."""
