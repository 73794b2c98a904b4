"""ROS bags: detecting them, and the files of a rosbag2 folder, which together are one log.

The folder's `metadata.yaml` names its files in order. It comes from a stranger: it is read as bounded plain text, and
only files within the folder are opened.
Source: github.com/ros2/rosbag2, rosbag2_storage/include/rosbag2_storage/yaml.hpp
"""

from __future__ import annotations

import shlex
from functools import lru_cache
from pathlib import Path
from typing import Any

from idtool.common.exceptions import ConfigError, LogError
from idtool.common.names import printable, stem
from idtool.common.safe_yaml import parse_yaml, yaml_bytes

METADATA = "metadata.yaml"
# First bytes of a file.
MCAP = b"\x89MCAP"
ZSTD = b"\x28\xb5\x2f\xfd"
SQLITE = b"SQLite format 3\0"
ROS1 = b"#ROSBAG V"

_INFORMATION = "rosbag2_bagfile_information"
_SUFFIXES = (".mcap", ".mcap.zstd", ".db3", ".db3.zstd")


def is_bag(path: Path) -> bool:
    """True if a path is a bag, readable or not: a folder with bag metadata or bag files, or one such file."""
    try:
        if path.is_dir():
            return (path / METADATA).is_file() or any(file.name.endswith(_SUFFIXES) for file in path.iterdir())
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(SQLITE)).startswith((MCAP, ZSTD, SQLITE, ROS1))
    except OSError:
        return False


def log_files(log: Path) -> list[Path]:
    """The files of a log: those of a rosbag2 folder, or the log itself; errors as in `bag_files`."""
    return bag_files(log) if log.is_dir() else [log]


def bag_files(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder, in the order of its metadata.

    Raises
    ------
    LogError
        If the folder has no metadata, or they name no readable file, or one outside the folder.
    """
    metadata = folder / METADATA
    if not metadata.is_file():
        raise LogError(
            folder,
            f"is a folder without {METADATA}, so it is not a rosbag2 folder. Run 'ros2 bag reindex "
            f"{shlex.quote(str(folder))} -s mcap' to create that file, or give one of the log files in the folder",
        )
    information = _bag_information(metadata)
    names = _file_names(information)
    storage = _text(information.get("storage_identifier"))
    if any(name.endswith((".db3", ".db3.zstd")) for name in names):
        storage = "sqlite3"
    if storage not in ("", "mcap"):  # empty after 'ros2 bag reindex'
        raise LogError(folder, wrong_storage_message(folder, storage))
    if _text(information.get("compression_mode")).upper() == "MESSAGE":
        message = f"uses per-message compression, which is not supported; {_conversion_advice(folder)}"
        raise LogError(folder, message)
    if not names:
        raise LogError(metadata, "names no files under relative_file_paths; run 'ros2 bag reindex' to write it again")
    if len(set(names)) < len(names):
        raise LogError(metadata, "names a file twice; run 'ros2 bag reindex' to write it again")
    return [_file_in(folder, name) for name in names]


def wrong_storage_message(path: Path, storage: str) -> str:
    """Error message for a bag that is not stored as MCAP, with the command that converts it."""
    return f"is stored as {printable(storage)}, not mcap; {_conversion_advice(path)}"


def ros1_message(path: Path) -> str:
    """Error message for a ROS 1 bag, with the command that converts it."""
    target = shlex.quote(f"{stem(path)}_mcap")
    return (
        f"is a ROS 1 bag; run 'rosbags-convert --src {shlex.quote(str(path))} --dst {target} --dst-storage mcap' "
        f"(pip install rosbags) and use {printable(target)}"
    )


def _conversion_advice(path: Path) -> str:
    """Command that converts a bag to MCAP; ``all`` works with every rosbag2, ``all_topics`` only with new ones."""
    target = printable(f"{stem(path)}_mcap")
    return (
        f"write 'output_bags: [{{uri: {target}, storage_id: mcap, all: true}}]' to out.yaml, "
        f"run 'ros2 bag convert -i {shlex.quote(str(path))} -o out.yaml' and use {target}"
    )


def _bag_information(metadata: Path) -> dict[str, Any]:
    """The bag's entry in its metadata, all values as text."""
    try:
        contents = _parse_metadata(metadata, yaml_bytes(metadata))
    except ConfigError as error:
        raise LogError(metadata, error.what) from None
    information = contents.get(_INFORMATION) if isinstance(contents, dict) else None
    if not isinstance(information, dict):
        raise LogError(metadata, f"has no {_INFORMATION}; it is not the metadata of a rosbag2 folder")
    return information


@lru_cache(maxsize=4)  # a command needs the files of its logs more than once
def _parse_metadata(metadata: Path, data: bytes) -> Any:
    return parse_yaml(metadata, data, as_text=True)


def _file_names(information: dict[str, Any]) -> list[str]:
    """The file names as the metadata have them: under ``relative_file_paths``, or else under ``files``."""
    paths = information.get("relative_file_paths")
    if not (isinstance(paths, list) and paths):
        files = information.get("files")
        files = files if isinstance(files, list) else []
        paths = [file.get("path") for file in files if isinstance(file, dict)]
    return [name for name in map(_text, paths) if name]


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _file_in(folder: Path, name: str) -> Path:
    """The file of that name in the folder."""
    outside_message = f"names {printable(name)}, which is outside the folder; only files within it are read"
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise LogError(folder / METADATA, outside_message)
    try:
        if not path.is_file() and (folder / path.name).is_file():
            path = folder / path.name  # the first recorders with compression put the folder's name in front
        exists = path.is_file()
        is_inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # an impossible file name, or a link to itself
        exists = is_inside = False
    if exists and not is_inside:
        raise LogError(folder / METADATA, outside_message)
    if not exists:
        raise LogError(
            folder / METADATA, f"names {printable(name)}, which is not in the folder; add the file or remove its name"
        )
    return path
