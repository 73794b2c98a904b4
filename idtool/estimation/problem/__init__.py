"""The optimization problem, its solvers, and what proves their solution."""
