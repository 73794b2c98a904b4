"""Bags: what a ROS user records, and the rosbag2 folder that is one log in several files.

The folder's `metadata.yaml` names its files, in order. It is a stranger's: it is read as plain text of bounded size
and depth, and only files within the folder are.
Source: github.com/ros2/rosbag2, rosbag2_storage/include/rosbag2_storage/yaml.hpp
"""

from __future__ import annotations

import shlex
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from idtool.common.exceptions import LogError
from idtool.common.names import printable, stem

METADATA = "metadata.yaml"
MCAP, ZSTD, SQLITE, ROS1 = b"\x89MCAP", b"\x28\xb5\x2f\xfd", b"SQLite format 3\0", b"#ROSBAG V"  # files' beginnings

_INFORMATION = "rosbag2_bagfile_information"
_MOST_BYTES = 4 << 20
_MOST_FILES = 10_000
_DEEPEST = 64  # lists and mappings within one another
_ENDINGS = tuple(f"{storage}{packed}" for storage in (".mcap", ".db3") for packed in ("", ".zstd"))
_EVENTS = getattr(yaml, "CBaseLoader", yaml.BaseLoader)  # events, not its nodes: those take 200 times the file's size


def is_bag(path: Path) -> bool:
    """Whether a path is a log that ROS records, readable or not: a folder with metadata or such files, or a file."""
    try:
        if path.is_dir():
            return (path / METADATA).is_file() or any(file.name.endswith(_ENDINGS) for file in path.iterdir())
        if not path.is_file():
            return False
        with path.open("rb") as file:
            return file.read(len(SQLITE)).startswith((MCAP, ZSTD, SQLITE, ROS1))
    except OSError:
        return False


def files_of(log: Path) -> list[Path]:
    """The files of a log: those of a rosbag2 folder, else the log itself; errors as in `bag_files`."""
    return bag_files(log) if log.is_dir() else [log]


def bag_files(folder: Path) -> list[Path]:
    """The files of a rosbag2 folder, in the order in which its metadata name them.

    Raises
    ------
    LogError
        If it has no metadata, or they name no file that is there and can be read, or one outside of it.
    """
    metadata = folder / METADATA
    if not metadata.is_file():
        raise LogError(
            folder,
            f"is a folder without {METADATA}; a rosbag2 folder holds that and the files it names. Let 'ros2 bag "
            f"reindex {shlex.quote(str(folder))} -s mcap' write it, or name a file in the folder",
        )
    information = _information(metadata)
    names = _names(information)
    storage = _text(information.get("storage_identifier"))
    if any(name.endswith((".db3", ".db3.zstd")) for name in names):
        storage = "sqlite3"
    if storage not in ("", "mcap"):  # none after a reindexing
        raise LogError(folder, not_mcap(folder, storage))
    if _text(information.get("compression_mode")).upper() == "MESSAGE":
        raise LogError(
            folder, f"holds messages that are compressed one by one, which is not read; {_conversion(folder)}"
        )
    if not names:
        raise LogError(metadata, "names no files under relative_file_paths; let 'ros2 bag reindex' write it anew")
    if len(names) > _MOST_FILES or len(set(names)) < len(names):
        what = "a file twice" if len(names) <= _MOST_FILES else f"more than {_MOST_FILES} files"
        raise LogError(metadata, f"names {what}; let 'ros2 bag reindex' write it anew")
    return [_within(folder, name) for name in names]


def not_mcap(path: Path, storage: str) -> str:
    """What is wrong with a bag of another storage, and how to convert it."""
    return f"is stored as {printable(storage)}, not mcap; {_conversion(path)}"


def of_ros1(path: Path) -> str:
    """What is wrong with a bag of ROS 1, and how to convert it."""
    target = shlex.quote(f"{stem(path)}_mcap")
    return (
        f"is a bag of ROS 1; run 'rosbags-convert --src {shlex.quote(str(path))} --dst {target} --dst-storage mcap' "
        f"(pip install rosbags) and give {printable(target)}"
    )


def _conversion(path: Path) -> str:
    """How to write a bag anew as MCAP; as ``all`` has always been understood, while ``all_topics`` is new."""
    target = printable(f"{stem(path)}_mcap")
    return (
        f"write 'output_bags: [{{uri: {target}, storage_id: mcap, all: true}}]' to out.yaml, "
        f"run 'ros2 bag convert -i {shlex.quote(str(path))} -o out.yaml' and give {target}"
    )


def _information(metadata: Path) -> dict[str, Any]:
    """What the metadata say, numbers as text."""
    size = metadata.stat().st_size
    if size > _MOST_BYTES:
        raise LogError(metadata, f"is larger than {_MOST_BYTES >> 20} MiB, which no bag's is")
    with metadata.open("rb") as file:
        data = file.read(size)
    try:
        read = _plain(data)
    except yaml.MarkedYAMLError as error:
        line = f" in line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise LogError(metadata, f"is not YAML{line}: {error.problem}") from None
    except Exception as error:  # the parser has no error of its own for what is no character
        raise LogError(metadata, f"is not YAML ({type(error).__name__})") from None
    information = read.get(_INFORMATION) if isinstance(read, dict) else None
    if not isinstance(information, dict):
        raise LogError(metadata, f"has no {_INFORMATION}; it is not the metadata of a rosbag2 folder")
    return information


@lru_cache(maxsize=4)  # a command asks for the files of its logs more than once
def _plain(data: bytes) -> Any:
    """What the first document of a YAML file holds: text, lists and mappings, whatever the tags say.

    Raises
    ------
    yaml.YAMLError
        If it is not YAML, or nests too deep.
    """
    within: list[tuple[str | None, list[Any]]] = [(None, [])]  # the lists and mappings that are open, by their anchors
    known: dict[str, Any] = {}
    value: Any
    for event in yaml.parse(data, Loader=_EVENTS):
        match event:
            case yaml.SequenceStartEvent() | yaml.MappingStartEvent():
                within.append((event.anchor, []))
                if len(within) > _DEEPEST:
                    raise yaml.MarkedYAMLError(problem=f"it nests more than {_DEEPEST} deep")
                continue
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                anchor, items = within.pop()
                value = items if isinstance(event, yaml.SequenceEndEvent) else _mapping(items)
            case yaml.ScalarEvent():
                anchor, value = event.anchor, event.value
            case yaml.AliasEvent():
                anchor, value = None, known.get(event.anchor or "", "")
            case yaml.DocumentEndEvent():
                break
            case _:
                continue
        within[-1][1].append(value)
        if anchor:
            known[anchor] = value
    return next(iter(within[0][1]), None)


def _mapping(items: list[Any]) -> dict[str, Any]:
    """Keys and values in turn, as a mapping; keys that are no text are left out."""
    return {key: value for key, value in zip(items[::2], items[1::2], strict=True) if isinstance(key, str)}


def _names(information: dict[str, Any]) -> list[str]:
    """The names of the files, as they stand in the metadata."""
    paths, files = (information.get(key) for key in ("relative_file_paths", "files"))
    if not (isinstance(paths, list) and paths):
        paths = [file.get("path") for file in files if isinstance(file, dict)] if isinstance(files, list) else []
    return [name for name in map(_text, paths) if name]


def _text(value: object) -> str:
    return value if isinstance(value, str) else ""


def _within(folder: Path, name: str) -> Path:
    """The file of that name, which is in the folder."""
    outside = f"names {printable(name)}, which is not within the folder; only files there are read"
    path = folder / name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise LogError(folder / METADATA, outside)
    try:
        if not path.is_file() and (folder / path.name).is_file():
            path = folder / path.name  # the first recorders that compressed wrote the folder's name before it
        there = path.is_file()
        inside = path.resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # a name that no file can have, or a link to itself
        there = inside = False
    if there and not inside:
        raise LogError(folder / METADATA, outside)
    if not there:
        raise LogError(
            folder / METADATA, f"names {printable(name)}, which is not in the folder; add it, or take it out"
        )
    return path
