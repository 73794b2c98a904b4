"""The configuration: YAML into frozen records. An unknown key is an error that names the nearest known one.

Units: rad or m, rad/s or m/s, N·m or N, kg, s; a prismatic joint takes the second of each pair.
"""

from idtool.robot.config.base import ConfigRecord, Positive, validate_record
from idtool.robot.config.bounds import BoundingEllipsoid, BoundingShape, HullBound
from idtool.robot.config.config import Config, parse_config, read_config
from idtool.robot.config.estimation import WEAK_PRIOR, KnownMasses, MeasuredValue, Mirror, Regularization, Solver
from idtool.robot.config.floating_base import Base, Contact
from idtool.robot.config.rotors import RotorConfig
from idtool.robot.config.signals import Controller
from idtool.robot.config.terms import EffectEntry, Friction, UncertainValue
from idtool.robot.config.wrench_sensors import WrenchSensor

__all__ = [
    "WEAK_PRIOR",
    "Base",
    "BoundingEllipsoid",
    "BoundingShape",
    "Config",
    "ConfigRecord",
    "Contact",
    "Controller",
    "EffectEntry",
    "Friction",
    "HullBound",
    "KnownMasses",
    "MeasuredValue",
    "Mirror",
    "Positive",
    "Regularization",
    "RotorConfig",
    "Solver",
    "UncertainValue",
    "WrenchSensor",
    "parse_config",
    "read_config",
    "validate_record",
]
