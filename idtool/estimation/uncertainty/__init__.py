"""How far to trust a fit: standard errors, what each number rests on, logs against each other, bias, prediction."""

from idtool.estimation.uncertainty.inquiry import Trust, trust

__all__ = ["Trust", "trust"]
