"""How well a model predicts: torque errors and rollouts."""
