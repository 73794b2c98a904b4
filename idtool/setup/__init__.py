"""A first configuration from a URDF and logs, with the source of each value in a comment."""

from idtool.setup.initial_config import make_initial_config
from idtool.setup.records import ConfigSection, InitialConfig, TodoItem, Trial

__all__ = ["ConfigSection", "InitialConfig", "TodoItem", "Trial", "make_initial_config"]
