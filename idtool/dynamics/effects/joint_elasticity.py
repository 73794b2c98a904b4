"""Joints whose motor and link sides are connected by a spring."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from typing_extensions import override

from idtool.common.arrays import Array, Mask, dilated
from idtool.common.number_text import short_number
from idtool.data.filters import DIFFERENCE_REACH, LowPass, differentiate
from idtool.data.power_density import power_density
from idtool.data.signals import Motion, reversals
from idtool.dynamics.effects.data_summary import DataSummary
from idtool.dynamics.effects.fixed_effect import FixedJointEffect
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.named_effect import NonlinearParameter
from idtool.dynamics.mechanism import Mechanism, Transmission
from idtool.robot.inverse_dynamics import inverse_dynamics
from idtool.robot.model import RobotModel

_DAMPING_RATIO = 0.05  # harmonic drives and belts have a few per cent
_CUTOFFS = (14.0, 20.0, 28.0, 40.0, 56.0)  # Hz: up to one of them the deflection is taken from the torque
_MAX_CUTOFF = 0.2  # of the sampling rate
_MIN_SIGNAL_TO_NOISE = 3.0  # power of the transmitted torque, its noise included, over that of the noise
_CLEAR_RESONANCES = 2.0  # times the link's resonance, above which more signal is needed
_WELCH_SAMPLES = 1024  # in each of the overlapping pieces whose spectra are averaged
_MAX_DIFFERENTIABLE = 0.25  # of the sampling rate, above which differentiating damps the noise too
_REVERSAL_GAP = 2e-3  # s about a reversal, in which the direction of the motor's friction is not known
_GAP_ITERATIONS = 4
_ORDER = 4  # of the low-pass
_MAX_STIFFNESS_ERROR = 0.15  # relative; what moves under load, such as a bristle of friction, fits with a vague one
_MOTOR_FRICTION_SHARES = (0.0, 0.5, 1.0)  # shares of friction on the motor side that are tried


class JointElasticity(FixedJointEffect):
    """A spring between motor and link: motor position − link position = transmitted torque / stiffness.

    The model is that of Spong, Modeling and control of elastic joint robots, ASME Journal of Dynamic Systems,
    Measurement, and Control 109 (1987), with a damper parallel to the spring and friction on the motor side::

        deflection:   delta = theta − q
        motor side:   tau = B d²theta/dt² + tau_f + tau_J
        spring:       tau_J = K delta + D d delta/dt
        link side:    tau_J = torque of all other effects along q, without B d²q/dt² and the motor's friction

    with the position theta of the motor and q of the link, the torque tau of the motor and tau_J that is transmitted,
    all at the joint output; the reflected inertia B of the rotors; and the damper D = 2 · 0.05 √(K B), 5 % of what is
    critical for the motor. ``stiffness`` is K [N·m/rad or N/m]. The friction tau_f of the motor is the share
    ``motor_friction`` of the joint's friction; the share may be left out, and is 0 then.

    In the torque equation the deflection is computed from the log:

    1. The motion of the motor, theta and its derivatives, and the torque tau are measured.
    2. The transmitted torque is tau less B d²theta/dt², with the prior inertia of the rotors and that of a
       `rotor_inertia`, and less tau_f, which the model with rigid joints gives along theta.
    3. Where the motor reverses, tau_f jumps at a time that is not known to the sample; a spring's torque does not jump.
       If tau_f is not 0, the transmitted torque within 2 ms of a reversal is therefore replaced by what continues the
       torque before and after it within the band of step 5.
    4. The damper makes the deflection lag the torque: delta + (D / K) d delta/dt = tau_J / K.
    5. A low-pass keeps what is below the highest frequency, of five from 14 to 56 Hz, at which the transmitted torque
       is above its noise. Above it, the second derivative would be mostly noise. That noise disturbs the torque of all
       joints, the more the softer the spring, so that the spring would seem stiffer than it is. Above twice the
       resonance of the link on its spring, the torque must therefore be the farther above its noise. At low sampling
       rates, the cutoff is at most a fifth of the rate.
    6. The motion of the link is that of the motor less the deflection and its two derivatives. All other effects,
       rotors and friction included, act along it.
    7. Rotors and tau_f act along theta, though: what they take more there is added to the torque.

    Samples at the ends of the data and near reversals of the link are left out; see `invalid_mask`. The forward model
    needs a rotor or a `rotor_inertia` on the joint.
    """

    id = "joint_elasticity"
    description = "the joint is elastic under load"
    excitation_hint = "quick reversals at high and at low load"
    cause = "acceleration"
    order = 1
    uses_measured_torque = True
    acts_at_reversals = True
    nonlinear_parameters = (
        NonlinearParameter("stiffness", ("N·m/rad", "N/m"), positive=True, max_relative_error=_MAX_STIFFNESS_ERROR),
        NonlinearParameter("motor_friction", optional_maximum=1.0),
    )

    def __init__(self, model: RobotModel, joint: int, nonlinear_values: Mapping[str, float] | None = None) -> None:
        super().__init__(model, joint, nonlinear_values)
        self._reflected_inertia = model.reflected_inertia()
        self._prior_link_inertia = _prior_inertia(model, joint) - self._reflected_inertia[joint, joint]
        self._rigid_joint_model: Callable[[Motion], Linearization] | None = None

    @classmethod
    @override
    def trial_values(cls, summary: DataSummary, joint: int) -> Iterator[Mapping[str, float]]:
        """Shares of friction on the motor side; none on a joint with backlash, where what gives is the teeth."""
        if summary.has_effect("backlash", summary.model.names[joint]):
            return
        for share in _MOTOR_FRICTION_SHARES:
            yield {"motor_friction": share}

    @classmethod
    @override
    def implausibility(cls, values: Mapping[str, Any], joint: str | None, summary: DataSummary) -> str:
        """Why no joint is as stiff or as soft: it would deflect by less than its noise, or by more than its travel."""
        j = summary.model.names.index(str(joint))
        deflection = float(summary.peak_torque[j]) / float(values["stiffness"])
        if deflection > summary.q_range[j]:
            return (
                f"it would deflect by {short_number(deflection, 2)} at the largest torque, more than the joint travels"
            )
        if deflection < summary.velocity_deadband[j] * summary.dt:
            return (
                f"it would deflect by {short_number(deflection, 2)} at the largest torque, less than the noise "
                "of the position"
            )
        return ""

    @classmethod
    @override
    def torque_derivative(
        cls,
        summary: DataSummary,
        joint: int,
        nonlinear_values: Mapping[str, float],
        motion: Motion,
        linearized: Linearization,
    ) -> Array:
        """Derivative of the predicted torque by the compliance c at c = 0, shape (nv, N) [(N·m)²/rad or N²/m].

        The compliance is 1 / stiffness. With it, the link moves by −delta and the rotors stay with the motor; to first
        order, `Linearization.torque_change_by_motion` gives the change of the bodies' torque by that. The change of
        friction is left out. The equation of the spring, divided by K, is::

            delta + T d delta/dt = c tau_J,    T = D / K = 2 · 0.05 √(B c)

        At c = 0, T is 0, so that d delta/dc = tau_J: the deflection of a spring of stiffness 1 without a damper.
        """
        unit_spring = cls(summary.model, joint, {"stiffness": 1.0})
        unit_spring.set_operating_point(lambda _: linearized, np.empty(0))
        motor_friction_torque = nonlinear_values["motor_friction"] * linearized.friction_torque(joint)
        q, v, a = unit_spring._deflection(motion, motor_friction_torque)
        return linearized.torque_change_by_motion(joint, -q, -v, -a)

    @classmethod
    @override
    def values_from_coefficient(cls, c: float, nonlinear_values: Mapping[str, float]) -> Mapping[str, float] | None:
        """The stiffness from the compliance c [rad/(N·m) or m/N]; None if that is not positive."""
        return {**nonlinear_values, "stiffness": 1 / c} if c > 0 else None

    @override
    def set_operating_point(self, model: Callable[[Motion], Linearization], theta: Array) -> None:
        self._rigid_joint_model = model

    @override
    def correct_motion(self, motion: Motion) -> Motion:
        """Motion of the link, from that of the motor; steps 1 to 6 of the class."""
        retardation_time = self._retardation_time(self._rotor_inertia(motion)[self.joint])
        friction = self._motor_friction_torque(motion)
        deflection = self._deflection(motion, friction, retardation_time, self._link_resonance())
        link_motion = self._displaced(motion, -deflection)
        return replace(link_motion, motor_minus_link={**motion.motor_minus_link, self.joint: deflection})

    @override
    def fixed_torque(self, motion: Motion) -> Array:
        """Torque of the motor side less that if the motor moved as the link, shape (nv, N) [N·m or N].

        On all joints that turn the rotors, B d²delta/dt²; on this one also the difference in motor friction. Step 7 of
        the class.
        """
        deflection = motion.motor_minus_link[self.joint]
        torque = np.outer(self._reflected_inertia[:, self.joint], deflection[2])
        if self.nonlinear_values["motor_friction"]:
            motor_motion = self._displaced(motion, deflection)
            torque[self.joint] += self._motor_friction_torque(motor_motion) - self._motor_friction_torque(motion)
        return torque

    def _motor_friction_torque(self, motion: Motion) -> Array:
        """Friction torque on the motor side where the motor moves by a motion, shape (N,) [N·m or N]."""
        share: float = self.nonlinear_values["motor_friction"]
        if not share or self._rigid_joint_model is None:
            return np.zeros(len(motion.t))
        return share * self._rigid_joint_model(motion).friction_torque(self.joint)

    def _displaced(self, motion: Motion, change: Array) -> Motion:
        """Motion with changes added to the joint's q, v and a, shape (3, N) [rad or m, and per s and s²]."""
        q, v, a = motion.q.copy(), motion.v.copy(), motion.a.copy()
        q[self.joint] += change[0]
        v[self.joint] += change[1]
        a[self.joint] += change[2]
        return replace(motion, q=q, v=v, a=a)

    @override
    def invalid_mask(self, motion: Motion) -> dict[int, Mask]:
        """Samples whose deflection is not known: joint index to a mask of shape (N,).

        On all joints, those at the ends, beyond which the deflection's low-pass reaches. On this joint also those near
        reversals of the link, where dry friction jumps: their time is known to half a period of the cutoff frequency.
        """
        count = len(motion.t)
        lowest_cutoff = _possible_cutoffs(motion.dt)[0]
        longest_edge = _low_pass(lowest_cutoff, motion.dt).edge
        edge = min(longest_edge, count)
        at_ends = np.zeros(count, dtype=bool)
        at_ends[:edge] = True
        at_ends[count - edge :] = True
        deflection = motion.motor_minus_link.get(self.joint, np.zeros((3, count)))
        cutoff = self._highest_clear_frequency(self._displaced(motion, deflection), self._link_resonance())
        half_period = 0.5 / max(cutoff, _CUTOFFS[0])  # a cutoff lowered to a low sampling rate does not lengthen it
        near_reversals = _near_reversals(motion.v[self.joint], half_period, motion.dt)
        return dict.fromkeys(range(len(motion.q)), at_ends) | {self.joint: at_ends | near_reversals}

    @override
    def add_to_forward_model(self, theta: Array, mechanism: Mechanism) -> None:
        transmission = mechanism.transmissions.get(self.joint, Transmission(np.inf, _DAMPING_RATIO))
        mechanism.transmissions[self.joint] = replace(
            transmission,
            stiffness=self.nonlinear_values["stiffness"],
            damping_ratio=_DAMPING_RATIO,
            motor_friction=max(transmission.motor_friction, self.nonlinear_values["motor_friction"]),
        )

    def _retardation_time(self, inertia: float) -> float:
        """Time constant D / K = 2 · 0.05 √(B / K) by which the damper makes the deflection lag the torque [s]."""
        return float(2 * _DAMPING_RATIO * np.sqrt(inertia / self.nonlinear_values["stiffness"]))

    def _link_resonance(self) -> float:
        """Frequency at which the link, with its prior inertia at the zero position, swings on the spring [Hz]."""
        stiffness = self.nonlinear_values["stiffness"]
        return float(np.sqrt(stiffness / max(self._prior_link_inertia, np.finfo(float).tiny)) / (2 * np.pi))

    def _deflection(
        self,
        motion: Motion,
        motor_friction_torque: Array,
        retardation_time: float = 0.0,
        link_resonance: float = np.inf,
    ) -> Array:
        """Deflection and its first two time derivatives, shape (3, N) [rad or m, and per s and s²].

        Steps 2 to 5 of the class.

        Parameters
        ----------
        motion
            Motion of the motor.
        motor_friction_torque
            Friction torque on the motor side, shape (N,) [N·m or N].
        retardation_time
            Time constant of the deflection's lag [s]; 0: no lag.
        link_resonance
            Resonance of the link on the spring [Hz]; infinite if the stiffness is not known yet.
        """
        dt = motion.dt
        transmitted = motion.tau[self.joint] - self._rotor_torque(motion) - motor_friction_torque
        low_pass = _low_pass(self._highest_clear_frequency(motion, link_resonance), dt)
        if motor_friction_torque.any():
            # Friction jumps where the motor reverses, and the transmitted torque does not.
            near_reversals = _near_reversals(motion.v[self.joint], _REVERSAL_GAP, dt)
            transmitted = _fill_gaps(transmitted, near_reversals, low_pass)
        if retardation_time:
            transmitted = _first_order_lag(transmitted, retardation_time, dt)

        # Each derivative loses samples at both ends: the deflection is continued beyond the data by what two lose.
        lost = DIFFERENCE_REACH
        q = _smoothed(transmitted, low_pass, margin=2 * lost)[None] / self.nonlinear_values["stiffness"]
        v = differentiate(q, dt)
        a = differentiate(v, dt)
        return np.concatenate([q[:, 2 * lost : -2 * lost], v[:, lost:-lost], a])

    def _rotor_torque(self, motion: Motion) -> Array:
        """Torque that accelerates the joint's rotors, shape (N,) [N·m or N]."""
        return np.asarray(self._rotor_inertia(motion) @ motion.a)

    def _rotor_inertia(self, motion: Motion) -> Array:
        """Torque that the rotors take on this joint per acceleration of each joint along a motion, shape (nv,)."""
        inertia: Array = self._reflected_inertia[self.joint].copy()
        if self._rigid_joint_model is not None:
            inertia[self.joint] += self._rigid_joint_model(motion).added_rotor_inertia(self.joint)
        return inertia

    def _highest_clear_frequency(self, motion: Motion, link_resonance: float) -> float:
        """Highest frequency at which the transmitted torque is above its noise, one of `_possible_cutoffs` [Hz].

        Step 5 of the class. Friction on the motor side is not subtracted from the torque here.
        """
        torque = motion.logged_tau[self.joint]
        rotor_torque = self._rotor_torque(motion)
        f, powers = _power_density(np.stack([torque, rotor_torque, torque - rotor_torque]), motion.dt)
        torque_power, rotor_power, transmitted_power = powers
        noise_power = _noise_power_density(f, torque_power, rotor_power, motion.dt)

        highest_clear, *higher_cutoffs = _possible_cutoffs(motion.dt)
        for cutoff in higher_cutoffs:
            octave = _octave_below(cutoff, f)
            if not octave.any():
                continue
            amplification = max((cutoff / (_CLEAR_RESONANCES * link_resonance)) ** 2, 1.0)
            min_ratio = _MIN_SIGNAL_TO_NOISE * amplification
            is_clear = transmitted_power[octave].mean() > min_ratio * noise_power[octave].max()
            if is_clear:  # whatever a lower octave is: the motion may have little power there
                highest_clear = cutoff
        return highest_clear


def _prior_inertia(model: RobotModel, joint: int) -> float:
    """Inertia that a joint accelerates, by the bodies' priors at the zero position [kg·m² or kg]."""
    zero = np.zeros((len(model.joints), 1))
    accelerated = zero.copy()
    accelerated[joint] = 1.0
    pi = np.stack([body.pi for body in model.bodies])
    torque = inverse_dynamics(model, pi, zero, zero, accelerated) - inverse_dynamics(model, pi, zero, zero, zero)
    return float(torque[joint, 0])


def _possible_cutoffs(dt: float) -> list[float]:
    """Those of `_CUTOFFS` that the sampling rate allows, ascending; the lowest is lowered to what it allows [Hz]."""
    limit = _MAX_CUTOFF / dt
    return [min(_CUTOFFS[0], limit), *(cutoff for cutoff in _CUTOFFS[1:] if cutoff < limit)]


def _noise_power_density(f: Array, torque_power: Array, rotor_power: Array, dt: float) -> Array:
    """Power density of the transmitted torque's noise at the frequencies f [Hz], shape (F,) [(N·m)²/Hz or N²/Hz].

    The noise of the measured torque is taken as white: its density is constant. That of the rotors' torque is the noise
    of the acceleration, taken as a derivative of white noise: its density increases with f². Both levels are medians
    in the quietest octave, since not all above the motion is noise: what an encoder's steps make a drive do is torque.

    Parameters
    ----------
    f
        Frequencies [Hz], shape (F,).
    torque_power, rotor_power
        Power density of the measured torque, and of what the rotors take of it, shape (F,).
    dt
        Sample time [s].
    """
    octaves = [_octave_below(top, f) for top in _octave_tops(dt)]
    octaves = [octave for octave in octaves if octave.any()]
    torque_level = min((np.median(torque_power[octave]) for octave in octaves), default=0.0)

    differentiable = [octave for octave in octaves if f[octave].max() < _MAX_DIFFERENTIABLE / dt]
    rotor_level = min((np.median(rotor_power[octave] / f[octave] ** 2) for octave in differentiable), default=0.0)
    return np.asarray(torque_level + rotor_level * f**2)


def _octave_tops(dt: float) -> list[float]:
    """Upper ends of the octaves in which noise is looked for, from the lowest cutoff on [Hz]."""
    tops = [*_CUTOFFS, *(_CUTOFFS[-1] * 2**k for k in range(1, 5))]
    return [top for top in tops if top < 0.5 / dt]


def _octave_below(top: float, f: Array) -> Mask:
    """True for the frequencies of the octave that ends at ``top`` [Hz], shape (F,)."""
    return (f > top / 2) & (f <= top)


def _power_density(x: Array, dt: float) -> tuple[Array, Array]:
    """Power density of signals x, shape (m, N), by Welch's method.

    Returns
    -------
    Frequencies [Hz], shape (F,), and the power density of each signal, shape (m, F) [its unit squared per Hz].
    """
    return power_density(x, dt, min(_WELCH_SAMPLES, x.shape[-1]))


def _near_reversals(v: Array, time: float, dt: float) -> Mask:
    """Samples within a time [s] of a reversal of the velocity, and at least the two on each side of it, shape (N,)."""
    reach = max(round(time / dt), 1)
    return dilated(reversals(v), reach)


def _smoothed(x: Array, low_pass: LowPass, margin: int = 0) -> Array:
    """A signal of shape (N,) after a low-pass, and continued beyond both ends by a margin, shape (N + 2 margin,)."""
    padded = np.pad(x, low_pass.reach + margin, mode="reflect", reflect_type="odd")
    return np.asarray(low_pass(padded[None], low_pass.reach, low_pass.reach)[0])


def _fill_gaps(x: Array, gap: Mask, low_pass: LowPass) -> Array:
    """A signal that is continued within the low-pass's band over gaps, where its samples are not used; shape (N,).

    A straight line over each gap first; then, repeatedly, the low-pass of the whole signal. Gerchberg, Super-resolution
    through error energy reduction, Optica Acta 21 (1974); Papoulis, A new algorithm in spectral analysis and
    band-limited extrapolation, IEEE Transactions on Circuits and Systems 22 (1975).
    """
    if gap.all():
        return x
    sample = np.arange(len(x))
    filled = x.copy()
    filled[gap] = np.interp(sample[gap], sample[~gap], x[~gap])
    for _ in range(_GAP_ITERATIONS):
        filled[gap] = _smoothed(filled, low_pass)[gap]
    return filled


def _first_order_lag(x: Array, time_constant: float, dt: float) -> Array:
    """Solution y of time_constant · dy/dt + y = x by the trapezoidal rule, from the steady state on, shape (N,)."""
    from scipy.signal import lfilter, lfilter_zi

    numerator = np.array([dt, dt]) / (2 * time_constant + dt)
    denominator = np.array([1.0, (dt - 2 * time_constant) / (2 * time_constant + dt)])
    steady_state = lfilter_zi(numerator, denominator) * x[0]
    y, _ = lfilter(numerator, denominator, x, zi=steady_state)
    return np.asarray(y)


@cache
def _low_pass(cutoff: float, dt: float) -> LowPass:
    return LowPass(cutoff, _ORDER, dt)
