"""Evaluation of a model: torque errors and rollouts."""
