"""A first configuration: all that URDF and logs tell, each piece with a word on where it came from."""

from idtool.setup.records import Section, Start, TodoItem, Trial
from idtool.setup.start import start

__all__ = ["Section", "Start", "TodoItem", "Trial", "start"]
