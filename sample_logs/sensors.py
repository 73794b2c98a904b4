"""What drives report of a simulated motion: quantised positions, their own velocity, noisy torque.

Letters as in two_mass.py: q [rad], v [rad/s], tau [N m], each (N, nj).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from bodies import Array
from scipy.signal import lfilter
from two_mass import RATE, Run


@dataclass(frozen=True)
class Sensors:
    """Steps and noise of a robot's drives; written to truth.yaml as it stands.

    Attributes
    ----------
    position_step
        Encoder resolution at the joint [rad].
    torque_noise
        Standard deviation of the white noise on the logged torque [N m].
    velocity_step
        Resolution of the reported velocity [rad/s]; zero: v is differenced from the quantised q and smoothed.
    velocity_lag
        By how much v then lags the derivative of q [s]; half a sample of it is the backward difference's own.
    """

    position_step: float
    torque_noise: float
    velocity_step: float = 0.0
    velocity_lag: float = 0.0

    def read(self, run: Run, rng: np.random.Generator) -> dict[str, Array]:
        """Signals as they go into the log."""
        q = np.round(run.q / self.position_step) * self.position_step
        tau = run.tau + rng.normal(0, self.torque_noise, run.tau.shape)
        if self.velocity_step:
            return {"q": q, "v": np.round(run.v / self.velocity_step) * self.velocity_step, "tau": tau}
        difference = np.diff(q, axis=0, prepend=q[:1]) * RATE
        keep = 1 / (0.5 + self.velocity_lag * RATE)  # a first-order low-pass lags by 1 / keep - 1 samples
        return {"q": q, "v": lfilter([keep], [1, keep - 1], difference, axis=0), "tau": tau}


@dataclass(frozen=True)
class Recording:
    """One log: when it starts [s], what truly happened, and what the drives said."""

    start: float
    run: Run
    signals: dict[str, Array]

    @property
    def t(self) -> Array:
        """Sample times (N,) [s]."""
        return self.start + np.arange(len(self.run.q)) / RATE

    @property
    def torque_noise(self) -> Array:
        """What the sensors added to the torque (N, nj) [N m]."""
        return self.signals["tau"] - self.run.tau
