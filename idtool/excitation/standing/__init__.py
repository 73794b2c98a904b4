"""Exciting trajectories of a robot whose feet stay on the ground."""
