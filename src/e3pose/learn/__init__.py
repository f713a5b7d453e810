"""Learning: the predictor from recordings, and beside a running system."""
