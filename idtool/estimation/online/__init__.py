"""Identification row by row, along with the robot."""
