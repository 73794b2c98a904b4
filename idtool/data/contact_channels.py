"""`ContactChannels`: when contacts are closed, and their measured wrenches, from the channels of a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from idtool.common.arrays import Array, Mask
from idtool.common.dataclass import dataclass
from idtool.data.base_sensors import BaseSensors
from idtool.data.logs.log import Channel, JointLog
from idtool.robot.config import Config, Contact


@dataclass(frozen=True)
class ContactSamples:
    """The contacts of a robot at N samples.

    Attributes
    ----------
    world_to_base
        Rotation of the world's axes into the base's frame, shape (3, 3, N): those of a floating base's world have z
        upward, those of a fixed one are its own.
    is_closed
        True where a contact may act: its flag, widened, is set, or it has none; shape (contacts, N).
    wrenches
        Measured force and moment on the link by what it touches, along the axes of the contact's ``frame``, shape
        (contacts, 6, N) [N, N·m]; 0 if they were not measured.
    radius_change
        By how much the balls are larger than configured [m].
    """

    world_to_base: Array
    is_closed: Mask
    wrenches: Array
    radius_change: float = 0.0

    def every(self, stride: int) -> ContactSamples:
        """One of every ``stride`` samples."""
        return replace(
            self,
            world_to_base=self.world_to_base[..., ::stride],
            is_closed=self.is_closed[:, ::stride],
            wrenches=self.wrenches[..., ::stride],
        )


@dataclass(frozen=True)
class ContactChannels:
    """The contacts of a robot in a log.

    Attributes
    ----------
    contacts
        The contacts.
    channels
        The log's channels, with those of the contacts.
    base_sensors
        Sensors of a floating base, which tell its orientation; None: the base is fixed.
    """

    contacts: tuple[Contact, ...]
    channels: Mapping[str, Channel]
    base_sensors: BaseSensors | None

    @classmethod
    def of_log(cls, log: JointLog, config: Config, base_sensors: BaseSensors | None) -> ContactChannels | None:
        """The contacts of a robot in a log; None for a fixed base without contacts."""
        if base_sensors is None and not config.contacts:
            return None
        return cls(config.contacts, log.channels, base_sensors)

    @property
    def lookahead(self) -> float:
        """Time after a sample until it is known if contacts are closed then, and their wrench is there [s]."""
        latest = 0.0
        for contact in self.contacts:
            if contact.flag is not None:
                latest = max(latest, contact.widen)
            wrench = [*(contact.force or ()), *(contact.moment or ())]
            latest = max([latest, *(self.channels[name].step for name in wrench)])
        return latest

    def samples(self, t: Array, outer: Array, smooth: Callable[[Array], Array]) -> ContactSamples:
        """The contacts at N samples.

        Parameters
        ----------
        t
            Times of the samples [s], shape (N,).
        outer
            Times of the samples and of those about them that ``smooth`` takes [s].
        smooth
            Low-pass of the signals, from those at the outer times to those of the samples.
        """
        is_closed = np.ones((len(self.contacts), len(t)), dtype=bool)
        wrenches = np.zeros((len(self.contacts), 6, len(t)))
        for k, contact in enumerate(self.contacts):
            if contact.flag_channel is not None:
                is_closed[k] = self.channels[contact.flag_channel].is_set(t, contact.widen)
            if contact.force is not None:
                wrenches[k, :3] = contact.sign * smooth(self._values(contact.force, outer))
            if contact.moment is not None:
                wrenches[k, 3:] = contact.sign * smooth(self._values(contact.moment, outer))
        return ContactSamples(self._world_to_base(t), is_closed, wrenches)

    def _values(self, names: Sequence[str], t: Array) -> Array:
        """Values of channels at times, shape (channels, N)."""
        return np.stack([self.channels[name].at(t) for name in names])

    def _world_to_base(self, t: Array) -> Array:
        """As in `ContactSamples`; the identity if no contact needs it."""
        needs_orientation = any(contact.needs_orientation for contact in self.contacts)
        if self.base_sensors is None or not needs_orientation:
            return np.broadcast_to(np.eye(3)[:, :, None], (3, 3, len(t)))
        return self.base_sensors.world_to_base(t)
