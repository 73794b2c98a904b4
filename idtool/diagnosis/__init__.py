"""Diagnosis: disagreement between a model and its logs, the effects that explain it, and the error that remains."""
