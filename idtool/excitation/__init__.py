"""Exciting trajectories: limits, patterns of motion, criteria, and the search for the best."""
