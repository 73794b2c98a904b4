"""`Explanation`: effects that may explain what a model lacks, and their torque along a motion.

Shapes: nv joints, N samples. Units: rad or m, s, N·m or N.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.data.signals import Motion, default_cutoff
from idtool.diagnosis.effect_search import EffectSearch
from idtool.diagnosis.trial import with_effects
from idtool.dynamics.effects import NamedEffect, build_effects, effect_from_entry, effect_types, friction_types
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.probe import Probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.excitation.patterns import Fourier, PatternSpec
from idtool.excitation.task import VELOCITY_DEADBAND, DesignTask
from idtool.robot.config import Config, EffectEntry, UncertainValue
from idtool.robot.model import RobotModel

_TYPICAL_SHARE = 0.1  # of a joint's rms torque, of an effect whose parameters are unknown
_TYPICAL_DURATION = 20.0  # s of the random motion on which such an effect has that share
_TYPICAL_RATE = 200.0  # Hz
_STEP = 1e-3  # of a parameter, or this if it is small: step of a finite difference
_SMALL_VALUE = 0.1  # below which a parameter counts as small

EffectKey = tuple[str, str | None]  # id of an effect, and the joint or link that it acts on


@dataclass(frozen=True)
class Explanation:
    """Effects with their parameters, which together may explain what a model lacks.

    Attributes
    ----------
    name
        As the user gave it.
    entries
        Their configuration entries.
    source
        Origin of the parameters: ``configuration``, ``logs``, ``typical size``, or a file's name.
    """

    name: str
    entries: tuple[EffectEntry, ...]
    source: str

    @property
    def keys(self) -> tuple[EffectKey, ...]:
        """The effects, each with what it acts on."""
        return tuple(_key_of(entry) for entry in self.entries)


def _key_of(entry: EffectEntry) -> EffectKey:
    return entry.effect, entry.joint or entry.link


def configured_entries(config: Config, key: EffectKey) -> tuple[EffectEntry, ...]:
    """Entries of an effect that a configuration has under `effects`, or with a value under `friction`."""
    entries = [entry for entry in config.effects if _key_of(entry) == key]
    if entries:
        return tuple(entries)
    effect, joint = key
    if joint is None:
        return ()
    for term, kind in friction_types().items():
        if kind.id != effect:
            continue
        value = getattr(config.friction_of(joint), term)
        if isinstance(value, UncertainValue) and value.value:
            return (EffectEntry(effect=effect, joint=joint, parameters={kind.coefficient_name: value.value}),)
    return ()


def without_effects(config: Config, model: RobotModel, keys: Sequence[EffectKey]) -> Config:
    """A configuration without effects, whether under `effects` or under `friction`."""
    entries = tuple(entry for entry in config.effects if _key_of(entry) not in keys)
    friction = {}
    for joint in model.names:
        dropped = {term: False for term, kind in friction_types().items() if (kind.id, joint) in keys}
        friction[joint] = config.friction_of(joint).model_copy(update=dropped)
    return config.model_copy(update={"effects": entries, "friction": friction})


def fitted_entry(experiment: Experiment, config: Config, key: EffectKey, progress: Progress) -> EffectEntry | None:
    """Entry of an effect with the parameters that explain logs best; None if they show nothing of it.

    Parameters
    ----------
    experiment
        The logs.
    config
        Configuration without the effect.
    key
        The effect.
    progress
        Callback for the stage and its progress, from 0 to 1.
    """
    without = with_effects(replace(experiment, config=config), config.effects)
    search = EffectSearch(without, (), 1, progress)
    try:
        search.assume(*key)
    except ConfigError:
        return None
    return search.reported[-1].entry


def typical_entry(task: DesignTask, config: Config, key: EffectKey) -> EffectEntry | None:
    """Entry of an effect of typical size, None if there is none.

    Of the nonlinear values that a diagnosis tries, those in the middle are taken. The coefficients are such that on a
    random motion within the limits, the effect's torque is a tenth of the rms torque of the joint where it is largest.

    Parameters
    ----------
    task
        Robot and limits.
    config
        Configuration without the effect.
    key
        The effect.
    """
    model = task.model
    equation = LinearModel(model.names, build_effects(model, config))
    motion = _random_motion(task, equation)
    band = config.filter.cutoff_hz or default_cutoff(1 / task.rate)
    probes = [probe for probe in _probes(equation, task, motion, band) if _is_probe_of(probe, key)]
    if not probes:
        return None
    probe = probes[len(probes) // 2]
    columns = probe.columns(motion, LinearizedModel(equation, equation.prior, motion))
    typical = _typical_coefficients(columns, motion, probe.coefficient_count)
    # A coefficient of 1 is the whole effect where the probe's column depends on the nonlinear values alone.
    for c in (typical, -typical, np.ones_like(typical)):
        if np.isfinite(c).all() and probe.is_feasible(c):
            entry = probe.to_entry(c, np.eye(len(c)))
            if entry is not None:
                return entry
    return None


def _typical_coefficients(columns: Mapping[int, Array], motion: Motion, count: int) -> Array:
    """Coefficients by which columns, shape (count, N) by joint, reach their share of the torque on some joint."""
    typical = np.zeros(count)
    for j, rows in columns.items():
        rms = np.sqrt(np.square(rows).mean(axis=1))
        torque = _TYPICAL_SHARE * np.sqrt(np.square(motion.tau[j]).mean()) / np.sqrt(len(rows))
        size = np.divide(torque, rms, out=np.full(len(rows), np.inf), where=rms > 0)
        typical = np.where(typical > 0, np.minimum(typical, size), size)
    return typical


def _is_probe_of(probe: Probe, key: EffectKey) -> bool:
    return (probe.effect, probe.joint or probe.link) == key


def _random_motion(task: DesignTask, equation: LinearModel) -> Motion:
    """A random motion within the limits, with its predicted torque as the measured one."""
    limits = task.limits
    pattern = Fourier(PatternSpec(task.model, limits, limits.middle, _TYPICAL_DURATION))
    t = np.arange(round(_TYPICAL_DURATION * _TYPICAL_RATE)) / _TYPICAL_RATE
    samples = pattern.motion(pattern.draw(np.random.default_rng(0)), t)
    zero = np.zeros_like(samples.q)
    deadband = np.full(len(zero), VELOCITY_DEADBAND)
    motion = Motion(t, *samples, tau=zero, logged_tau=zero, velocity_deadband=deadband, dt=1 / _TYPICAL_RATE)
    tau = equation.torque(motion, equation.prior)
    return replace(motion, tau=tau, logged_tau=tau)


def _probes(equation: LinearModel, task: DesignTask, motion: Motion, band: float) -> Iterator[Probe]:
    """All hypotheses that a diagnosis of a log of the motion would try."""
    summary = DataSummary(
        model=task.model,
        effect_keys=frozenset(effect.key for effect in equation.effects if isinstance(effect, NamedEffect)),
        q_min=motion.q.min(axis=1),
        q_max=motion.q.max(axis=1),
        rms_velocity=np.sqrt(np.square(motion.v).mean(axis=1)),
        peak_torque=np.abs(motion.tau).max(axis=1),
        velocity_deadband=motion.velocity_deadband,
        dt=motion.dt,
        duration=float(motion.t[-1]),
        band_hz=band,
    )
    for kind in effect_types().values():
        yield from kind.probes(summary)


class ExplanationTorque:
    """Torque that an explanation adds to a model, and its derivatives by the parameters.

    Attributes
    ----------
    size
        Number of rows of `rows`: one for each number among the parameters, and one for the torque itself.

    Parameters
    ----------
    model
        The robot.
    config
        Configuration of the model without the explanation.
    explanation
        The effects.
    """

    def __init__(self, model: RobotModel, config: Config, explanation: Explanation) -> None:
        self._model = model
        self._config = config
        self._equation = self._equation_with(explanation.entries)
        self._perturbed: list[tuple[LinearModel, float]] = []
        for i, entry in enumerate(explanation.entries):
            for name, index, value in _numbers(entry):
                step = _STEP * max(abs(value), _SMALL_VALUE)
                self._perturbed.append(self._perturbed_equation(explanation.entries, i, (name, index, value), step))
        self.size = len(self._perturbed) + 1

    def rows(self, motion: Motion, common_torque: Array) -> Array:
        """Derivatives by the parameters and, last, the torque; shape (size, nv, N).

        Parameters
        ----------
        motion
            The motion, with the measured or predicted torque.
        common_torque
            Torque of the model without the explanation, shape (nv, N).
        """
        whole = self._equation.torque(motion, self._equation.prior)
        rows = []
        for equation, step in self._perturbed:
            rows.append((equation.torque(motion, equation.prior) - whole) / step)
        rows.append(whole - common_torque)
        return np.stack(rows)

    def _equation_with(self, entries: Sequence[EffectEntry]) -> LinearModel:
        """The model with further effects."""
        config = self._config.model_copy(update={"effects": (*self._config.effects, *entries)})
        return LinearModel(self._model.names, build_effects(self._model, config))

    def _perturbed_equation(
        self, entries: Sequence[EffectEntry], i: int, number: tuple[str, int | None, float], step: float
    ) -> tuple[LinearModel, float]:
        """The model with one number of an entry changed by a step, which is negative where it may not be larger."""
        name, index, value = number
        for signed_step in (step, -step):
            given: object = value + signed_step
            if index is not None:
                given = list(entries[i].values[name])
                given[index] = value + signed_step
            entry = entries[i].model_copy(update={"parameters": {**entries[i].parameters, name: given}})
            try:
                effect_from_entry(entry, self._model)
            except ConfigError:
                continue
            return self._equation_with([*entries[:i], entry, *entries[i + 1 :]]), signed_step
        raise ConfigError(f"effects: {entries[i].effect}", f"{name} of {value:g} is at both ends of its range")


def _numbers(entry: EffectEntry) -> Iterator[tuple[str, int | None, float]]:
    """Name, index within a list, and value of each number among an entry's parameters."""
    for name, value in entry.values.items():
        if isinstance(value, int | float):
            yield name, None, float(value)
        elif isinstance(value, list) and all(isinstance(x, int | float) for x in value):
            for index, x in enumerate(value):
                yield name, index, float(x)
