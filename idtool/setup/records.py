"""Records of a first configuration."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from idtool.common.dataclass import dataclass
from idtool.common.notice import Notice


@dataclass(frozen=True)
class ConfigSection:
    """One key of the configuration.

    Attributes
    ----------
    key
        The key.
    comments
        Meaning and source of the value, one line each.
    value
        Plain data; None if there is only a template.
    remarks
        Comments above the template, one line each.
    template
        Plain data that is written commented out; beside a value, more entries of the same mapping.
    """

    key: str
    comments: tuple[str, ...]
    value: Any = None
    remarks: tuple[str, ...] = ()
    template: Any = None


@dataclass(frozen=True)
class Trial:
    """An effect that was tried.

    Attributes
    ----------
    effect
        Id of the effect.
    joint
        The joint; None: the whole robot.
    value
        Fitted value [SI].
    before, after
        Held-out RMS of the joint's torque without and with it, in the band [N·m or N]; None if no data
        of the joint were held out.
    kept
        True if it is in the configuration.
    """

    effect: str
    joint: str | None
    value: float
    before: float | None
    after: float | None
    kept: bool


@dataclass(frozen=True)
class TodoItem:
    """A value that the user has to fill in.

    Attributes
    ----------
    key
        Key in the configuration.
    what
        Description of what is missing.
    needed
        True if `idtool fit` needs it.
    """

    key: str
    what: str
    needed: bool = False


@dataclass(frozen=True)
class InitialConfig:
    """A first configuration.

    Attributes
    ----------
    data
        The configuration as plain data.
    text
        The same as YAML with comments and templates.
    findings
        Findings from the URDF and the logs, one line each.
    todo
        Values that the user has to fill in.
    trials
        The trials.
    rms
        Held-out RMS torque error with friction alone and with all kept effects, by joint and ``overall`` [N·m or N];
        None without trials.
    band_hz
        The filter's cut-off [Hz].
    notices
        Notices for the user.
    """

    data: Mapping[str, Any]
    text: str
    findings: tuple[str, ...]
    todo: tuple[TodoItem, ...]
    trials: tuple[Trial, ...]
    rms: Mapping[str, Mapping[str, float]] | None
    band_hz: float
    notices: tuple[Notice, ...]

    @property
    def needed(self) -> tuple[TodoItem, ...]:
        """Values that `idtool fit` needs."""
        return tuple(item for item in self.todo if item.needed)
