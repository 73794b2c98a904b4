"""Parameters from data: the reduced data, the optimization problem, the uncertainty of its solution, and the fit."""
