"""Checks of a log of a robot on its feet by kinematics alone: orientation of the IMU, pose, and feet that slip."""

from __future__ import annotations

from collections.abc import Iterator

from idtool.common.notice import Notice
from idtool.data.base_sensors import pose_sensors
from idtool.data.signals import Signals
from idtool.estimation.dataset.foot_kinematics import flagged_feet, foot_motions
from idtool.estimation.dataset.foot_slip import SlipSearch, slip_notices
from idtool.estimation.dataset.imu_mount import disagreement_notice, fit_gyroscope, mount_notice, scale_notice
from idtool.estimation.dataset.pose_check import pose_against_imu
from idtool.robot.config import Config
from idtool.robot.model import RobotModel

KINEMATIC_FAULTS = ("imu_mount", "foot_slip")


def kinematic_notices(signals: Signals, model: RobotModel, config: Config) -> Iterator[Notice]:
    """Notices about an IMU that is rotated relative to its link, a pose that differs from it, and feet that slip.

    Parameters
    ----------
    signals
        A log.
    model
        The tree of bodies.
    config
        The configuration; without a floating base, there are no notices.
    """
    if not model.has_floating_base:
        return
    pose = pose_sensors(signals.log, model, config)
    if pose is not None and not config.base.uses_pose:
        disagreement = pose_against_imu(signals, pose)
        if disagreement is not None:
            yield disagreement
            pose = None
    feet = flagged_feet(config.contacts, model, signals.log)
    if not feet:
        return
    imu_to_base = model.frames[config.base.sensor.link or model.robot.root].R
    search = SlipSearch([foot.name for foot in feet], signals.log.start)
    fits = []
    for motion in foot_motions(signals, model, feet, pose):
        fits.append(fit_gyroscope(motion, imu_to_base))
        search.add(motion)
    if not fits:
        return
    fit = sum(fits[1:], start=fits[0])
    # with one of these, all feet seem to slip
    wrong_sensor = mount_notice(fit, model.robot, config.base, imu_to_base)
    wrong_sensor = wrong_sensor or scale_notice(fit, config.base, imu_to_base)
    if wrong_sensor is not None:
        yield wrong_sensor
        return
    slips = search.slips()
    yield from slip_notices(slips)
    disagreement = disagreement_notice(fit, config.base, imu_to_base)
    if disagreement is not None and not slips:  # which would explain it
        yield disagreement
