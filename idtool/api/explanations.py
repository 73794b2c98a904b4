"""The two explanations of `excite --decide`: parsed, and with their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from idtool.api.effect_arguments import EffectAssumption, check_assumptions, parse_assumption
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.dynamics.effects import effect_types
from idtool.estimation.dataset.experiment import Experiment, Progress
from idtool.excitation.explanations import (
    Explanation,
    configured_entries,
    fitted_entry,
    typical_entry,
    without_effects,
)
from idtool.excitation.task import DesignTask
from idtool.robot.config import Config, EffectEntry, read_config

_OPTION = "--decide"
_FILE_ENDINGS = (".yaml", ".yml")


@dataclass(frozen=True)
class Alternative:
    """An explanation as a user gave it: the entries of a file, or an effect and what it acts on."""

    text: str
    entries: tuple[EffectEntry, ...]
    effect: EffectAssumption | None

    @property
    def keys(self) -> tuple[EffectAssumption, ...]:
        """The effects, each with what it acts on."""
        if self.effect is not None:
            return (self.effect,)
        return Explanation(self.text, self.entries, "").keys


def parse_alternatives(texts: Sequence[str]) -> tuple[Alternative, Alternative]:
    """Two explanations, each ``effect:joint`` or a configuration file with effects.

    Raises
    ------
    ConfigError
        If one is neither, or they are the same.
    """
    if len(texts) != 2:
        raise ConfigError(_OPTION, f"{len(texts)} explanations; give two")
    a = _parse(texts[0])
    b = _parse(texts[1])
    if a.effect == b.effect and a.entries == b.entries:
        raise ConfigError(_OPTION, f"{a.text} and {b.text} are the same explanation; give two different ones")
    return a, b


def _parse(text: str) -> Alternative:
    if not text.lower().endswith(_FILE_ENDINGS):
        return Alternative(text, (), parse_assumption(text, _OPTION))
    entries = tuple(read_config(Path(text)).effects)
    if not entries:
        raise ConfigError(_OPTION, f"{text} has no effects; give a configuration that has, or EFFECT:JOINT")
    return Alternative(text, entries, None)


def find_explanations(
    alternatives: tuple[Alternative, Alternative],
    task: DesignTask,
    config: Config,
    experiment: Experiment | None,
    progress: Progress,
) -> tuple[Explanation, Explanation]:
    """Explanations with their parameters: of the configuration, fitted to the logs, or typical ones.

    Parameters
    ----------
    alternatives
        The explanations as the user gave them.
    task, config
        Robot and limits, and the configuration.
    experiment
        The existing logs; None without any.
    progress
        Callback for the stage and its progress, from 0 to 1.

    Raises
    ------
    ConfigError
        If the robot cannot have one of the effects, or its parameters are not known.
    """
    first, second = alternatives
    keys = [*first.keys, *second.keys]
    check_assumptions(keys, task.model, _OPTION)
    for effect, _ in keys:
        if effect_types()[effect].acts_in_bursts:
            what = f"{effect} acts in certain time intervals, whatever the motion, so none can be designed for it"
            raise ConfigError(_OPTION, f"{what}; give another effect")
    common = without_effects(config, task.model, keys)
    first_explanation = _with_parameters(first, task, config, common, experiment, progress)
    second_explanation = _with_parameters(second, task, config, common, experiment, progress)
    return first_explanation, second_explanation


def _with_parameters(
    alternative: Alternative,
    task: DesignTask,
    config: Config,
    common: Config,
    experiment: Experiment | None,
    progress: Progress,
) -> Explanation:
    """An explanation with its parameters; ``common`` is the configuration without either explanation."""
    if alternative.effect is None:
        return Explanation(alternative.text, alternative.entries, alternative.text)
    entries = configured_entries(config, alternative.effect)
    if entries:
        return Explanation(alternative.text, entries, "configuration")
    if experiment is not None:
        entry = fitted_entry(experiment, common, alternative.effect, progress)
        if entry is not None:
            return Explanation(alternative.text, (entry,), "logs")
    entry = typical_entry(task, common, alternative.effect)
    if entry is None:
        what = f"the parameters of {alternative.text} are not known"
        raise ConfigError(_OPTION, f"{what}; give them under effects in the configuration, or a log with --log")
    return Explanation(alternative.text, (entry,), "typical size")
