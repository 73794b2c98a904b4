"""The version of idtool."""

from importlib.metadata import version

VERSION = version("idtool")
