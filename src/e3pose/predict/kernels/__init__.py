"""The compiled parts of the predictors."""
