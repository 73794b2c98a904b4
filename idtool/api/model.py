"""`Model`: a URDF with its configuration."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

from idtool.api.log import Log
from idtool.common.exceptions import IdtoolError
from idtool.common.names import join_names, stem
from idtool.data.base_sensors import sensor_options
from idtool.data.logs import read_log
from idtool.data.logs.message_options import message_options
from idtool.data.robot_source import read_robot_and_logs
from idtool.dynamics.armature import with_armature
from idtool.dynamics.effects import friction_types
from idtool.estimation.fit import Fit
from idtool.reporting.fit_report import joint_dynamics, model_config
from idtool.reporting.results.base import ReadOnly
from idtool.robot.config import Config, parse_config, read_config
from idtool.robot.model import RobotModel, build_model
from idtool.robot.urdf.reading import Robot, parse_robot
from idtool.robot.urdf.writing import identified_urdf, relocate_meshes

Source = str | os.PathLike[str]
IDENTIFIED_URDF, MODEL_YAML = "identified.urdf", "model.yaml"  # what fit and diagnose write
_IDENTIFIED_ORIGIN = "the identified parameters"


class Model:
    """A robot: a URDF, and a configuration with everything that a URDF does not contain. A model cannot be changed.

    Whether URDF and configuration are consistent is checked when the model is used.

    Parameters
    ----------
    urdf
        The URDF, or a ROS bag (MCAP file or rosbag2 folder) that contains it as ``/robot_description``.
    config
        The configuration: a YAML file, or a dictionary with the same content. None: the file beside the URDF
        (``<urdf stem>.yaml``, beside an ``identified.urdf`` also ``model.yaml``), else the defaults.

    Raises
    ------
    ModelError
        If the URDF cannot be read.
    ConfigError
        If the configuration cannot be read, or a key in it is not known.

    Examples
    --------
    >>> model = idtool.Model("sample_logs/leg.urdf")
    >>> model
    Model leg.urdf with leg.yaml
      joints: abad, hip, knee
      bodies: abad_link, thigh_link, shank_link, abad_rotor, hip_rotor, knee_rotor
      effects: viscous_friction, coulomb_friction
    """

    def __init__(self, urdf: Source, config: Source | Mapping[str, Any] | None = None) -> None:
        self._robot, _ = read_robot_and_logs(Path(urdf), ())
        self._config, self._origin = _settings_and_name(Path(urdf), config)

    @classmethod
    def with_logs(cls, urdf: Path, logs: Sequence[Path], config: Path | None = None) -> tuple[Model, list[Path]]:
        """A model and its logs as a command names them: a bag in place of the URDF is the first of the logs.

        Parameters
        ----------
        urdf
            The URDF, or a bag, whose robot it or another of the logs describes.
        logs
            The logs, or the other logs.
        config
            As above.

        Raises
        ------
        IdtoolError
            As above.
        """
        model = cls.__new__(cls)
        model._robot, all_logs = read_robot_and_logs(urdf, logs)
        model._config, model._origin = _settings_and_name(urdf, config)
        return model, all_logs

    @classmethod
    def identified(cls, fit: Fit) -> Model:
        """The identified model, as its files would be read back.

        Parameters
        ----------
        fit
            The result.
        """
        model = cls.__new__(cls)
        original = fit.experiment.model.robot.path
        robot = parse_robot(original, identified_urdf_text(fit))  # its meshes are found from there
        model._robot = replace(robot, source=replace(robot.source, path=f"{original}, identified"))
        model._config = parse_config(model_config(fit), MODEL_YAML)
        model._origin = _IDENTIFIED_ORIGIN
        return model

    @classmethod
    def bare(cls, urdf: Source) -> Model:
        """The model of a URDF without any configuration, whatever lies beside it."""
        model = cls(urdf, {})
        model._origin = ""
        return model

    @property
    def path(self) -> Path:
        """The URDF; for an identified model, the original one."""
        return self._robot.path

    @property
    def name(self) -> str:
        """Name in reports: the path, with ``, identified`` for an identified model."""
        if self._origin == _IDENTIFIED_ORIGIN:
            return f"{self.path}, identified"
        return str(self.path)

    @property
    def robot(self) -> Robot:
        """The parsed URDF."""
        return self._robot

    @property
    def settings(self) -> Config:
        """The parsed configuration."""
        return self._config

    @property
    def configured(self) -> bool:
        """True if the model has a configuration of its own."""
        return bool(self._origin)

    @property
    def config(self) -> dict[str, Any]:
        """The configuration as plain data (a copy), without keys that have their default value."""
        return self._config.model_dump(mode="json", exclude_unset=True)

    @property
    def urdf(self) -> str:
        """The URDF's text."""
        return self._robot.text.decode(errors="replace")

    @property
    def joints(self) -> tuple[str, ...]:
        """The joints that are identified if the logs contain all of them.

        Raises
        ------
        IdtoolError
            If URDF and configuration are inconsistent; the same for `bodies` and `effects`.
        """
        return self._tree.names

    @property
    def bodies(self) -> tuple[str, ...]:
        """Moving links, then rotors. Links on fixed joints are part of the links that carry them."""
        return tuple(body.name for body in self._tree.bodies)

    @property
    def effects(self) -> ReadOnly[tuple[str, ...]]:
        """Effects of the model in addition to rigid bodies: ids with the joints or links that they act on."""
        friction = friction_types()
        owners: dict[str, list[str]] = {}
        for joint in self.joints:
            for term, setting in self._config.friction_of(joint):
                if setting is not False:
                    owners.setdefault(friction[term].id, []).append(joint)
        for entry in with_armature(self._config, self._tree).effects:
            names = owners.setdefault(entry.effect, [])
            owner = entry.joint or entry.link
            if owner:
                names.append(owner)
        return ReadOnly({effect: tuple(names) for effect, names in owners.items()})

    @cached_property
    def _tree(self) -> RobotModel:
        moving = []
        for joint in self._robot.joints.values():
            if joint.kind != "fixed" and not joint.mimic and joint.name not in self._config.locked_joints:
                moving.append(joint.name)
        return build_model(self._robot, self._config, moving)

    def read_log(self, path: Source) -> Log:
        """Read a log with the settings of the configuration.

        Parameters
        ----------
        path
            The log file.

        Raises
        ------
        LogError
            If it cannot be read.
        """
        options = self._config.log
        record = read_log(
            path,
            topic=options.topic,
            columns=options.columns,
            scale=dict(options.scale),
            sensors=sensor_options(self._config),
            messages=message_options(options, self._robot.joints),
        )
        return Log.from_record(record)

    def __repr__(self) -> str:
        title = f"Model {self.path.name}" + (f" with {self._origin}" if self._origin else "")
        try:
            lines = [f"joints: {join_names(self.joints)}", f"bodies: {join_names(self.bodies)}"]
            effects = []
            for effect, owners in self.effects.items():
                is_everywhere = owners in ((), self.joints)
                effects.append(effect if is_everywhere else f"{effect} on {join_names(owners)}")
            if effects:
                lines.append(f"effects: {', '.join(effects)}")
        except IdtoolError as error:  # a prompt shows what is wrong, too
            lines = [f"cannot be used: {error}"]
        return "\n  ".join([title, *lines])


def as_model(model: Model | Source) -> Model:
    """The model itself, or the one in a URDF with the configuration beside it."""
    return model if isinstance(model, Model) else Model(model)


def identified_urdf_text(fit: Fit, folder: Path | None = None) -> bytes:
    """The content of identified.urdf, in another folder than the URDF's own if one is given."""
    model = fit.experiment.model
    bodies = {body.name: (body, fit.parameters(i)) for i, body in enumerate(model.bodies)}
    text = identified_urdf(model.robot, bodies, joint_dynamics(fit))
    return text if folder is None else relocate_meshes(text, model.robot.path, folder)


def load_settings(given: Source | Mapping[str, Any] | None) -> Config:
    """The configuration in a file or a dictionary; the defaults for None."""
    if given is None:
        return Config()
    return parse_config(given, "config") if isinstance(given, Mapping) else read_config(Path(given))


def _settings_and_name(urdf: Path, given: Source | Mapping[str, Any] | None) -> tuple[Config, str]:
    """The configuration and its name: the one given, the one beside the URDF, or the defaults without a name."""
    if given is not None:
        return load_settings(given), "a configuration" if isinstance(given, Mapping) else Path(given).name
    names = [f"{stem(urdf)}.yaml", f"{stem(urdf)}.yml"]
    if urdf.stem == "identified":
        names.append(MODEL_YAML)
    for path in map(urdf.with_name, names):
        if path.is_file():
            return read_config(path), path.name
    return Config(), ""
