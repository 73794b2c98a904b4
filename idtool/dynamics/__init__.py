"""The torque equation: effects, the linear model that they add up to, and its simulation forwards."""
