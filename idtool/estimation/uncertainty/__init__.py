"""Uncertainty of a fit: standard errors, identifiability, agreement between logs, bias and prediction."""

from idtool.estimation.uncertainty.analysis import UncertaintyAnalysis, uncertainty_analysis

__all__ = ["UncertaintyAnalysis", "uncertainty_analysis"]
