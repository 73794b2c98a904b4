"""Identify the dynamics of robot legs and arms from logged joint data."""

from importlib.metadata import version

__version__ = version("idtool")
