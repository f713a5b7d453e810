"""Evaluation of motion predictors on recordings."""
