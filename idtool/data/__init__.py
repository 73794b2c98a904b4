"""Recorded data: logs, their faults, and the motion and torque signals made of them."""
