"""Identify the dynamics of robot legs and arms from logged joint data.

Public names are imported when they are first used, so `import idtool` itself is fast.

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
    from idtool.api.adapt import AdaptationResult, adapt
    from idtool.api.compare import ComparisonResult, compare
    from idtool.api.diagnose import DiagnosisResult, diagnose
    from idtool.api.ellipsoids import CheckResult, EllipsoidsResult, check, ellipsoids
    from idtool.api.excite import ExcitationResult, excite
    from idtool.api.export import ExportResult, export
    from idtool.api.fit import FitResult, fit
    from idtool.api.init import InitResult, init
    from idtool.api.inspect import InspectionResult, inspect
    from idtool.api.log import Log, read_log
    from idtool.api.model import Model
    from idtool.api.reduce import ReductionResult, reduce
    from idtool.api.sample import SampleResult, sample
    from idtool.api.simulate import SimulationResult, simulate
    from idtool.api.study import StudyResult, study
    from idtool.api.validate import ValidationResult, validate
    from idtool.common.exceptions import ConfigError, IdtoolError, LogError, ModelError, SolverError
else:  # a type checker is not to take every name for a public one

    def __getattr__(name: str) -> Any:
        """A public name, imported now (PEP 562)."""
        if name == "__version__":
            value: Any = import_module("idtool.common.version").VERSION
        elif name in _MODULE_OF:
            value = getattr(import_module(_MODULE_OF[name]), name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = value
        return value


__all__ = [
    "AdaptationResult",
    "CheckResult",
    "ComparisonResult",
    "ConfigError",
    "DiagnosisResult",
    "EllipsoidsResult",
    "ExcitationResult",
    "ExportResult",
    "FitResult",
    "IdtoolError",
    "InitResult",
    "InspectionResult",
    "Log",
    "LogError",
    "Model",
    "ModelError",
    "ReductionResult",
    "SampleResult",
    "SimulationResult",
    "SolverError",
    "StudyResult",
    "ValidationResult",
    "__version__",
    "adapt",
    "check",
    "compare",
    "diagnose",
    "ellipsoids",
    "excite",
    "export",
    "fit",
    "init",
    "inspect",
    "read_log",
    "reduce",
    "sample",
    "simulate",
    "study",
    "validate",
]

_NAMES = {
    "idtool.api.adapt": ("AdaptationResult", "adapt"),
    "idtool.api.compare": ("ComparisonResult", "compare"),
    "idtool.api.diagnose": ("DiagnosisResult", "diagnose"),
    "idtool.api.ellipsoids": ("CheckResult", "EllipsoidsResult", "check", "ellipsoids"),
    "idtool.api.excite": ("ExcitationResult", "excite"),
    "idtool.api.export": ("ExportResult", "export"),
    "idtool.api.fit": ("FitResult", "fit"),
    "idtool.api.init": ("InitResult", "init"),
    "idtool.api.inspect": ("InspectionResult", "inspect"),
    "idtool.api.log": ("Log", "read_log"),
    "idtool.api.model": ("Model",),
    "idtool.api.reduce": ("ReductionResult", "reduce"),
    "idtool.api.sample": ("SampleResult", "sample"),
    "idtool.api.simulate": ("SimulationResult", "simulate"),
    "idtool.api.study": ("StudyResult", "study"),
    "idtool.api.validate": ("ValidationResult", "validate"),
    "idtool.common.exceptions": ("ConfigError", "IdtoolError", "LogError", "ModelError", "SolverError"),
}
_MODULE_OF = {name: module for module, names in _NAMES.items() for name in names}


def __dir__() -> list[str]:
    return sorted(__all__)
