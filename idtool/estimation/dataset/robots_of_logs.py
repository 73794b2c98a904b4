"""The robot of a fleet that each log is of."""

from __future__ import annotations

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from idtool.common.exceptions import ConfigError
from idtool.common.names import join_names, printable
from idtool.robot.config.pool import Pool


def robots_of_logs(pool: Pool, logs: Sequence[Path]) -> list[str]:
    """Name of the robot of each log: as the configuration says, else that of the folder that the log is in.

    Raises
    ------
    ConfigError
        If a log is of no robot or of several, a robot has no log, or all logs are of one.
    """
    robots = [_robot_by_pattern(pool, log) for log in logs] if pool.robots else _robots_by_folder(logs)
    for name in robots:
        if name in ("", ".", "..") or "/" in name or "\\" in name or not name.isprintable():
            raise ConfigError(f"pool.robots: {printable(name)}", "cannot be the name of a folder; give another name")
    unused = [name for name in pool.robots if name not in robots]
    if unused:
        raise ConfigError(f"pool.robots: {unused[0]}", "no log is of this robot; remove it, or correct its patterns")
    if len(set(robots)) < 2:
        what = f"all logs are of one robot, {printable(robots[0])}"
        raise ConfigError("pool", f"{what}; put those of each robot into a folder, or list them under pool.robots")
    return robots


def _robots_by_folder(logs: Sequence[Path]) -> list[str]:
    """Name of the folder of each log."""
    folders: dict[str, Path] = {}
    names = []
    for log in logs:
        folder = log.absolute().parent
        if not folder.name:
            what = f"the log {log} is in no folder that could name its robot"
            raise ConfigError("pool", f"{what}; list it under pool.robots")
        other = folders.setdefault(folder.name, folder)
        if other != folder:
            what = f"two folders are named {printable(folder.name)}: {other} and {folder}"
            raise ConfigError("pool", f"{what}; list the robots under pool.robots")
        names.append(folder.name)
    return names


def _robot_by_pattern(pool: Pool, log: Path) -> str:
    """Name of the robot of which a pattern is that of the log's name, or of the end of its path."""
    path = log.absolute().as_posix()
    robots = []
    for name, patterns in pool.robots.items():
        if any(fnmatchcase(path, pattern) or fnmatchcase(path, f"*/{pattern}") for pattern in patterns):
            robots.append(name)
    if len(robots) != 1:
        what = f"the log {log} is of {join_names(robots) if robots else 'none of the robots'}"
        raise ConfigError("pool.robots", f"{what}; give patterns by which each log is of one robot")
    return robots[0]
