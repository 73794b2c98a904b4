"""Simulated robots on the ground, with logs of their joints, IMU and contacts. Shares no code with idtool."""
