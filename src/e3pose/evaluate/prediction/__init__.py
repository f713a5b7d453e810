"""How well predictors foresee the motion of recordings."""
