"""What a first configuration is made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from idtool.common.notice import Notice


@dataclass(frozen=True)
class Section:
    """One key of the configuration.

    Attributes
    ----------
    key
        The key.
    comments
        What it is and where it came from, a line each.
    value
        Plain data; None: the key is only there as a template.
    remarks
        What is said above the template, a line each.
    template
        Plain data that is written commented out; in a mapping beside a value, more entries of it.
    """

    key: str
    comments: tuple[str, ...]
    value: Any = None
    remarks: tuple[str, ...] = ()
    template: Any = None


@dataclass(frozen=True)
class Trial:
    """One thing that was tried.

    Attributes
    ----------
    effect
        Its id.
    joint
        The joint; None: all of them.
    value
        What the fit makes of it [SI].
    before, after
        Held-out RMS of the joint's torque without and with it, in the band [N·m or N]; None where nothing was held out
        of the joint.
    kept
        Whether it stands in the configuration.
    """

    effect: str
    joint: str | None
    value: float
    before: float | None
    after: float | None
    kept: bool


@dataclass(frozen=True)
class TodoItem:
    """One thing that a person has to fill in.

    Attributes
    ----------
    key
        Of the configuration.
    what
        What is missing, in words.
    needed
        Whether `idtool fit` cannot do without.
    """

    key: str
    what: str
    needed: bool = False


@dataclass(frozen=True)
class Start:
    """A first configuration.

    Attributes
    ----------
    data
        What it says, plain data.
    text
        The same as YAML with comments and templates.
    found
        What was found out, a line each.
    left
        What is left to fill in.
    trials
        What was tried.
    rms
        Held-out RMS torque error with friction alone and with all that was found, by joint and ``overall`` [N·m or N];
        None where nothing could be tried.
    band_hz
        The filter's cut-off [Hz].
    notices
        What a user should know.
    """

    data: Mapping[str, Any]
    text: str
    found: tuple[str, ...]
    left: tuple[TodoItem, ...]
    trials: tuple[Trial, ...]
    rms: Mapping[str, Mapping[str, float]] | None
    band_hz: float
    notices: tuple[Notice, ...]

    @property
    def needed(self) -> tuple[TodoItem, ...]:
        """What `idtool fit` cannot do without."""
        return tuple(left for left in self.left if left.needed)
