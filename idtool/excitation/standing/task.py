"""`StandingTask`: robot, feet, limits and criterion of a trajectory design for a robot that stands.

The rows are those of the torque equation behind the elimination of the contact forces, in units of the noise, as `fit`
has them. What these forces can explain in all postures of one stance is no base parameter.

Shapes: n joints, nv coordinates of the model, N samples, d independent coordinates, r base parameters, p coefficients.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from idtool.common.arrays import Array
from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ModelError
from idtool.common.number_text import short_number
from idtool.common.units import STANDARD_GRAVITY
from idtool.data.signals import Motion
from idtool.dynamics.contact_model import ContactModel
from idtool.dynamics.regressor import LinearModel
from idtool.estimation.dataset.equality_constraints import EqualityConstraints
from idtool.estimation.uncertainty.base_parameters import BaseParameters, base_parameters
from idtool.excitation.criteria import (
    BaseColumns,
    Criterion,
    DesignCriterion,
    base_parameter_scales,
    favoured_indices,
)
from idtool.excitation.limits import Limits, joint_limits
from idtool.excitation.logged_data import LoggedData
from idtool.excitation.patterns import MotionSamples
from idtool.excitation.standing.coordinates import coordinate_limits
from idtool.excitation.standing.feet import find_feet
from idtool.excitation.standing.ground_forces import GroundForces, GroundLimits
from idtool.excitation.standing.kinematics import FootKinematics, StandingKinematics, StandingSamples
from idtool.excitation.standing.robot import Loads, StandingRobot
from idtool.excitation.standing.stance import find_stance, foot_rotations
from idtool.excitation.task import (
    NOISE_SHARE,
    TYPICAL_TORQUE,
    VELOCITY_DEADBAND,
    DesignTask,
    check_noise_names,
    independent_rate,
)
from idtool.robot.collision import SelfCollision
from idtool.robot.config import Config
from idtool.robot.inertia import PI_SIZE
from idtool.robot.model import RobotModel

_MIN_LOAD = 0.45  # of an even share of the weight, on every foot
_FORCE_ERROR = 0.1  # of an even share of the weight, by which the force along the ground may differ from predicted
_SOLE_SHARE = 0.8  # of a sole, in which the centre of pressure stays
_NOISE_ARM = 0.1  # m, at which the noise of a force on the base acts
_RANDOM_SAMPLES = 300  # postures and motions from which the base parameters follow
_RANDOM_SHARE = 0.5  # of the coordinates' limits
_RANDOM_SEED = 0


@dataclass(frozen=True)
class StandingOptions:
    """Options of a trajectory with the feet on the ground.

    Attributes
    ----------
    feet
        Names of the contacts that stay on the ground; none: those at the ends of limbs.
    friction_coefficient
        Of the feet on the ground.
    sole_size
        Length and width of the soles [m]; None: from the links' geometry.
    start
        Positions of joints at the stance, by name [rad or m].
    """

    feet: tuple[str, ...]
    friction_coefficient: float
    sole_size: tuple[float, float] | None
    start: Mapping[str, float]


@dataclass(frozen=True)
class StandingTask(DesignTask):
    """A trajectory design for a robot that stands.

    Attributes
    ----------
    kinematics
        Motion of the robot with its feet on the ground.
    robot
        The robot on its feet.
    soles
        Rotation of every foot's link to the world, shape (3, 3) each.
    coordinate_limits
        Limits of the independent coordinates.
    friction_coefficient
        That of the ground, without margin.
    """

    kinematics: StandingKinematics
    robot: StandingRobot
    soles: tuple[Array, ...]
    coordinate_limits: Limits
    friction_coefficient: float

    def standing_motion(self, samples: StandingSamples, t: Array, velocity_deadband: Array) -> Motion:
        """Samples as the torque equation takes them."""
        return self.robot.motion(samples.motion, samples.base_to_world, t, velocity_deadband)

    def loads(self, samples: StandingSamples, t: Array) -> Loads:
        """Torques of the joints, and loads of the feet, along a motion."""
        motion = self.standing_motion(samples, t, np.full(len(self.model.joints), VELOCITY_DEADBAND))
        required = self.equation.torque(motion, self.theta)
        jacobian = self.kinematics.foot_jacobian(samples.w)
        return self.robot.loads(required, jacobian, list(self.soles))

    def coordinate_use(self, samples: StandingSamples) -> Array:
        """Distances of the independent coordinates from the middle, as shares of half their range, shape (d, N)."""
        limits = self.coordinate_limits
        u = samples.w[self.kinematics.independent]
        return np.asarray(np.abs(u - limits.middle[:, None]) / limits.half_range[:, None])

    def excess(self, samples: StandingSamples) -> Array:
        """By how much the independent coordinates are beyond their limits, as shares of half their range, (d, N)."""
        return np.maximum(self.coordinate_use(samples) - 1, 0.0)

    def base_selections(self) -> list[Array]:
        """Matrices from the columns of each row to those of the base parameters in units of their scales, (m_j, r)."""
        own = np.searchsorted(self.equalities.free, self.base.own)
        K = self.equalities.K[:, own] * self.scales
        return [K[active] for active in self.equation.active_in_columns()]


def make_standing_task(
    model: RobotModel,
    equation: LinearModel,
    equalities: EqualityConstraints,
    config: Config,
    standing: StandingOptions,
    logged: LoggedData | None,
    *,
    rate: float,
    margin: float,
    clearance: float,
    criterion: Criterion,
    favour: Sequence[str],
    noise: Mapping[str, float],
) -> StandingTask:
    """The task of designing a trajectory for a robot that stands.

    Parameters
    ----------
    model, equation, equalities, config
        The robot with a floating base, its torque equation, the constraints between its coefficients, and the
        configuration.
    standing
        The feet and the ground.
    logged
        Data that was logged before; None without any.
    rate, margin, clearance, criterion, favour
        As for `make_design_task`; the margin applies to the friction coefficient too.
    noise
        Noise in the band by row [N·m or N]; that of others is a share of the effort limit, or of the weight.

    Raises
    ------
    ConfigError
        If limits contradict each other, a name is not known, or the feet cannot carry a robot.
    ModelError
        If no stance was found.
    """
    check_noise_names(model, noise)
    feet = find_feet(model, config, standing.feet, standing.sole_size)
    full = joint_limits(model, config)
    limits = full.with_margin(margin)
    sigma, assumed = _row_noise(model, limits, noise)
    if equation.contacts is None:
        raise AssertionError  # a floating base has contacts
    equation = _with_noise(equation, equation.contacts, sigma)
    even_load = STANDARD_GRAVITY * model.mass / len(feet)
    friction_coefficient = (1 - margin) * standing.friction_coefficient
    ground = GroundLimits(friction_coefficient, _MIN_LOAD * even_load, _SOLE_SHARE, _FORCE_ERROR * even_load)
    foot_kinematics = FootKinematics(model, feet)
    forces = GroundForces(feet, _controller_stiffness(model, config), ground)
    robot = StandingRobot(model, equation, equation.prior, limits, foot_kinematics, forces)
    collision = SelfCollision.from_model(model, config.locked_joints)
    stance = find_stance(robot, collision, clearance, standing.start)
    soles = foot_rotations(foot_kinematics, stance)
    kinematics = StandingKinematics(foot_kinematics, stance)
    coordinates = coordinate_limits(robot, kinematics, soles)

    rows = _random_rows(robot, kinematics, coordinates)
    if logged is not None:
        rows = np.concatenate([rows, _logged_rows(logged, len(equation.prior))])
    base = _base_parameters(model, equalities, rows)
    typical = _typical_magnitudes(rows)
    return StandingTask(
        model=model,
        equation=equation,
        equalities=equalities,
        theta=equation.prior,
        robot_limits=full,
        limits=limits,
        collision=collision,
        clearance=clearance,
        base=base,
        columns=BaseColumns(equation, base, equalities),
        scales=base_parameter_scales(base, equation, typical),
        noise=sigma,
        noise_assumed=assumed,
        rate=rate,
        independent_rate=independent_rate(config, rate),
        criterion=DesignCriterion(criterion, favoured_indices(favour, base, equation)),
        kinematics=kinematics,
        robot=robot,
        soles=tuple(soles),
        coordinate_limits=coordinates,
        friction_coefficient=standing.friction_coefficient,
    )


def _base_parameters(model: RobotModel, equalities: EqualityConstraints, rows: Array) -> BaseParameters:
    """Base parameters by rows, shape (rows, p), those of friction and effects first; ModelError if there are none."""
    others_first = np.argsort(equalities.free < PI_SIZE * len(model.bodies), kind="stable")
    of_free = base_parameters(equalities.free_columns(rows), others_first)
    if not len(of_free):
        raise ModelError(model.robot.path, "has no parameter that a motion of this stance could determine")
    B = np.zeros((len(of_free), rows.shape[1]))
    B[:, equalities.free] = of_free.B
    return BaseParameters(equalities.free[of_free.own], B)


def _with_noise(equation: LinearModel, contacts: ContactModel, noise: Array) -> LinearModel:
    """The equation with other noise of the rows."""
    return LinearModel(equation.joints, equation.effects, equation.operating_point, contacts.with_noise(noise))


def _controller_stiffness(model: RobotModel, config: Config) -> Array:
    """Stiffness of the joint controllers, shape (n,); equal ones where the configuration has none."""
    n = model.joint_count
    if config.controller is None:
        return np.ones(n)
    stiffness = np.array([config.controller.kp_of(name) or 0.0 for name in model.joint_names])
    return stiffness if (stiffness > 0).all() else np.ones(n)


def _row_noise(model: RobotModel, limits: Limits, given: Mapping[str, float]) -> tuple[Array, tuple[str, ...]]:
    """Noise of each row (nv,), and the rows whose noise is assumed."""
    n = model.joint_count
    force = NOISE_SHARE * STANDARD_GRAVITY * model.mass
    largest = np.where(np.isfinite(limits.effort), limits.effort, force * _NOISE_ARM / NOISE_SHARE)
    wrench = np.repeat([force, force * _NOISE_ARM], 3)
    assumed = np.concatenate([NOISE_SHARE * largest, np.tile(wrench, (len(model.joints) - n) // len(wrench))])
    noise = np.array([given.get(name, x) for name, x in zip(model.names, assumed, strict=True)])
    assumed_rows = [
        f"{name} {short_number(x)}" for name, x in zip(model.names, noise, strict=True) if name not in given
    ]
    return noise, tuple(assumed_rows)


def _random_rows(robot: StandingRobot, kinematics: StandingKinematics, limits: Limits) -> Array:
    """Rows behind the elimination of contact forces along random motions of the stance, shape (rows, p)."""
    rng = np.random.default_rng(_RANDOM_SEED)
    shape = (len(limits.joints), _RANDOM_SAMPLES)
    u = limits.middle[:, None] + _RANDOM_SHARE * limits.half_range[:, None] * rng.uniform(-1, 1, shape)
    du = limits.velocity[:, None] * rng.uniform(-1, 1, shape)
    ddu = limits.acceleration[:, None] * rng.uniform(-1, 1, shape)
    samples = kinematics.samples(u, du, ddu)
    t = np.arange(_RANDOM_SAMPLES, dtype=float)
    deadband = np.full(len(robot.model.joints), VELOCITY_DEADBAND)
    motion = robot.motion(samples.motion, samples.base_to_world, t, deadband)
    equation = robot.equation
    if equation.contacts is None:
        raise AssertionError  # a floating base has contacts
    Y = np.zeros((_RANDOM_SAMPLES, len(robot.model.joints), len(equation.prior)))
    for row, (active, block) in enumerate(zip(equation.active_in_columns(), equation.columns(motion), strict=True)):
        Y[:, row, active] = block[:-1].T / equation.contacts.noise[row]
    projected = equation.contacts.projector(motion, {}) @ Y
    return np.asarray(projected[samples.is_reached].reshape(-1, Y.shape[2]))


def _logged_rows(logged: LoggedData, coefficients: int) -> Array:
    """Rows of the data that was logged before in units of their noise, shape (rows, p)."""
    rows = []
    for factor, sigma in zip(logged.reduction, logged.noise, strict=True):
        rows.append(factor.R[:, :coefficients] / (sigma * np.sqrt(max(factor.rows, 1))))
    return np.concatenate(rows)


def _typical_magnitudes(rows: Array) -> Array:
    """Coefficients that make ten times the noise in rows in units of it, shape (p,); 1 for those without effect."""
    rms = np.sqrt(np.square(rows).mean(axis=0))
    return np.asarray(np.divide(TYPICAL_TORQUE, rms, where=rms > 0, out=np.ones_like(rms)))


def joint_samples(task: StandingTask, samples: StandingSamples) -> MotionSamples:
    """The joints' part of samples, shape (n, N) each."""
    n = task.model.joint_count
    return MotionSamples(*(signal[:n] for signal in samples.motion))
