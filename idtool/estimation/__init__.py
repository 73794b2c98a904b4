"""Parameters from data: the reduced data, the optimization problem, how far to trust its solution, and the fit."""
