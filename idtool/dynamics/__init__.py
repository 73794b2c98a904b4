"""The torque equation: its effects, the linear model that they form, and its simulation."""
