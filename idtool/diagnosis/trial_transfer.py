"""Trial fits as bytes that a copy of this process sends back: without the logs, which both processes have."""

from __future__ import annotations

import io
import pickle
from typing import Any

from typing_extensions import override

from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.diagnosis.trial import TrialFit, with_effects_at
from idtool.estimation.dataset.experiment import Experiment


def trial_to_bytes(trial: TrialFit) -> bytes:
    """Bytes of a trial, from which `trial_from_bytes` restores it."""
    buffer = io.BytesIO()
    _TrialPickler(buffer).dump(trial)
    return buffer.getvalue()


def trial_from_bytes(data: bytes, base: LinearizedFit) -> TrialFit:
    """Trial that this process or a copy of it has turned into bytes.

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
    """Pickles experiments by reference: their address, which a copy shares, their effects and operating point."""

    @override
    def persistent_id(self, obj: object) -> object:
        if isinstance(obj, Experiment):
            return id(obj), obj.config.effects, dict(obj.equation.operating_point)
        return None


class _TrialUnpickler(pickle.Unpickler):
    """Restores the experiments from their references; those of the base are the same objects again."""

    def __init__(self, buffer: io.BytesIO, base: LinearizedFit) -> None:
        super().__init__(buffer)
        self._base = base.experiment
        self._experiments = {id(experiment): experiment for experiment in (base.experiment, base.row_experiment)}

    @override
    def persistent_load(self, pid: Any) -> Experiment:
        address, entries, operating_point = pid
        if address not in self._experiments:
            self._experiments[address] = with_effects_at(self._base, entries, operating_point)
        return self._experiments[address]
