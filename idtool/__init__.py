"""Identify the dynamics of robot legs and arms from logged joint data.

What is here is imported when it is first used: `import idtool` alone costs next to nothing.

Examples
--------
>>> import idtool
>>> model = idtool.Model("sample_logs/leg.urdf")
>>> result = idtool.fit(model, "sample_logs/leg_train.mcap", quick=True)
>>> round(result.rms.validation["overall"], 2)
0.11
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from idtool.api.diagnose import DiagnosisResult, diagnose
    from idtool.api.fit import FitResult, fit
    from idtool.api.log import Log, read_log
    from idtool.api.model import Model
    from idtool.api.simulate import SimulationResult, simulate
    from idtool.api.validate import ValidationResult, validate
    from idtool.common.exceptions import ConfigError, IdtoolError, LogError, ModelError, SolverError
else:  # a type checker is not to take every name for a public one

    def __getattr__(name: str) -> Any:
        """A public name, imported now (PEP 562)."""
        if name == "__version__":
            value: Any = import_module("idtool.common.version").VERSION
        elif name in _HOMES:
            value = getattr(import_module(_HOMES[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value


__all__ = [
    "ConfigError",
    "DiagnosisResult",
    "FitResult",
    "IdtoolError",
    "Log",
    "LogError",
    "Model",
    "ModelError",
    "SimulationResult",
    "SolverError",
    "ValidationResult",
    "__version__",
    "diagnose",
    "fit",
    "read_log",
    "simulate",
    "validate",
]

_HOMES = {
    **dict.fromkeys(
        ("ConfigError", "IdtoolError", "LogError", "ModelError", "SolverError"), "idtool.common.exceptions"
    ),
    **dict.fromkeys(("DiagnosisResult", "diagnose"), "idtool.api.diagnose"),
    **dict.fromkeys(("FitResult", "fit"), "idtool.api.fit"),
    **dict.fromkeys(("Log", "read_log"), "idtool.api.log"),
    "Model": "idtool.api.model",
    **dict.fromkeys(("SimulationResult", "simulate"), "idtool.api.simulate"),
    **dict.fromkeys(("ValidationResult", "validate"), "idtool.api.validate"),
}


def __dir__() -> list[str]:
    return sorted(__all__)
