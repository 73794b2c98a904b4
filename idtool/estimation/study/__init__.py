"""Constraint sets, priors and estimators side by side on the same data."""
