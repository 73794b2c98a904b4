"""Trial fits as bytes that a copy of this process sends back: without the logs, which both processes have."""

from __future__ import annotations

import io
import pickle
from typing import Any

from typing_extensions import override

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.trial import TrialFit, with_effects_at
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment


def trial_to_bytes(trial: TrialFit, base: LinearizedFit) -> bytes:
    """Bytes of a trial.

    Parameters
    ----------
    trial
        The trial.
    base
        The fit that it was compared with.
    """
    buffer = io.BytesIO()
    _TrialPickler(buffer, base).dump(trial)
    return buffer.getvalue()


def trial_from_bytes(data: bytes, base: LinearizedFit) -> TrialFit:
    """Trial from the bytes that `trial_to_bytes` made of it in a copy of this process.

    Parameters
    ----------
    data
        The bytes.
    base
        The fit that it was compared with.
    """
    trial: TrialFit = _TrialUnpickler(io.BytesIO(data), base).load()
    return trial


class _TrialPickler(pickle.Pickler):
    """Names experiments by what distinguishes them from the base's, and equations by whose they are."""

    def __init__(self, buffer: io.BytesIO, base: LinearizedFit) -> None:
        super().__init__(buffer)
        self._base = base

    @override
    def persistent_id(self, obj: object) -> object:
        if isinstance(obj, Experiment):
            return obj.config.effects, dict(obj.equation.operating_point)
        if isinstance(obj, LinearModel):
            return "base" if obj is self._base.row_equation else "trial"
        return None


class _TrialUnpickler(pickle.Unpickler):
    """Finds what `_TrialPickler` named."""

    def __init__(self, buffer: io.BytesIO, base: LinearizedFit) -> None:
        super().__init__(buffer)
        self._base = base
        self._experiment = base.experiment

    @override
    def persistent_load(self, pid: Any) -> object:
        if pid == "base":
            return self._base.row_equation
        if pid == "trial":
            return self._experiment.equation  # a fit names its experiment first
        entries, operating_point = pid
        self._experiment = with_effects_at(self._base.experiment, entries, operating_point)
        return self._experiment
