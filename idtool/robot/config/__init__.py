"""The configuration: YAML into frozen records. An unknown key is an error that names the nearest known one.

Units as in the contract: rad or m, rad/s or m/s, N·m or N, kg, s; a prismatic joint takes the second of each pair.
"""

from idtool.robot.config.base import Positive, Record, checked
from idtool.robot.config.bounds import Bounding, BoundingShape, HullBound
from idtool.robot.config.config import Config, parse_config, read_config
from idtool.robot.config.estimation import WEAK, Known, Measured, Mirror, Regularization, Solver
from idtool.robot.config.rotors import Rotor
from idtool.robot.config.signals import Controller
from idtool.robot.config.terms import EffectEntry, Friction, Uncertain

__all__ = [
    "WEAK",
    "Bounding",
    "BoundingShape",
    "Config",
    "Controller",
    "EffectEntry",
    "Friction",
    "HullBound",
    "Known",
    "Measured",
    "Mirror",
    "Positive",
    "Record",
    "Regularization",
    "Rotor",
    "Solver",
    "Uncertain",
    "checked",
    "parse_config",
    "read_config",
]
