"""rosbag2 folders that are refused: what a stranger's metadata may name, and bags that are to be converted."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from commands import refuse
from recordings import Channel, bag, metadata, ros2, states, write_mcap

from idtool.common.exceptions import LogError
from idtool.data.logs import is_bag, read_log

ITEMS = states(300)
PARTS = ITEMS[:100], ITEMS[100:220], ITEMS[220:]


def test_a_folder_without_metadata(tmp_path: Path) -> None:
    said = r"run: is a folder without metadata.yaml, so it is not a rosbag2 folder. Run .*give one of the log files"
    (tmp_path / "run").mkdir()
    with pytest.raises(LogError, match=said):
        read_log(tmp_path / "run")
    assert not is_bag(tmp_path / "run")
    (tmp_path / "run" / "notes.txt").write_text("x")
    assert not is_bag(tmp_path / "run")


@pytest.mark.parametrize("name", ["run_0.mcap", "run_0.mcap.zstd", "run_0.db3", "run_0.db3.zstd"])
def test_a_recorder_that_was_killed_before_it_wrote_the_metadata(tmp_path: Path, name: str) -> None:
    """The folder is a bag in the URDF's place too, so that what to do is said, not that a log is missing."""
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / name).write_bytes(b"x")
    assert is_bag(tmp_path / "run")
    for arguments in (["run"], ["run", "run"]):
        refuse(tmp_path, "fit", *arguments, naming="Run 'ros2 bag reindex run -s mcap' to create that file", file="run")
        (tmp_path / "out").rename(tmp_path / f"out{len(arguments)}")


@pytest.mark.parametrize("start", [b"\x89MCAP0\r\n", b"\x28\xb5\x2f\xfd", b"SQLite format 3\0", b"#ROSBAG V2.0\n"])
def test_a_file_is_a_bag_by_its_first_bytes(tmp_path: Path, start: bytes) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(start + bytes(100))
    assert is_bag(path)
    path.write_bytes(start[:3] + bytes(100))
    assert not is_bag(path)


def test_ros1_is_to_be_converted(tmp_path: Path) -> None:
    path = tmp_path / "my run.bag"
    path.write_bytes(b"#ROSBAG V2.0\nE\0\0\0" + bytes(100))
    with pytest.raises(LogError, match="is a ROS 1 bag") as error:
        read_log(path)
    command = f"rosbags-convert --src '{path}' --dst 'my run_mcap' --dst-storage mcap"
    assert command in str(error.value)


CONVERT = "write 'output_bags: [{uri: run_mcap, storage_id: mcap, all: true}]' to out.yaml, run 'ros2 bag convert -i "


def test_sqlite_is_to_be_converted(tmp_path: Path) -> None:
    for i, changes in enumerate(({"storage_identifier": "sqlite3"}, {"relative_file_paths": ["run_0.db3"]})):
        (tmp_path / str(i)).mkdir()
        folder = bag(tmp_path / str(i) / "run", *PARTS, **changes)
        with pytest.raises(LogError, match="run: is stored as sqlite3, not mcap; ") as error:
            read_log(folder)
        assert f"{CONVERT}{folder} -o out.yaml' and use run_mcap" in str(error.value)
    (tmp_path / "run.db3").write_bytes(b"SQLite format 3\0" + bytes(4096))
    with pytest.raises(LogError, match="is stored as sqlite3, not mcap") as error:
        read_log(tmp_path / "run.db3")
    assert CONVERT in str(error.value)
    inner = yaml.safe_load(CONVERT.split("'")[1])
    assert inner == {"output_bags": [{"uri": "run_mcap", "storage_id": "mcap", "all": True}]}


REFUSED: dict[str, tuple[str | bytes, str]] = {
    "another storage": (metadata(["run_0.mcap"], storage_identifier="leveldb"), "is stored as leveldb, not mcap"),
    "compressed messages": (metadata(["run_0.mcap"], compression_mode="MESSAGE"), "uses per-message compression"),
    "above": (metadata(["../secret.mcap"]), "names ../secret.mcap, which is outside the folder"),
    "above, by a way round": (metadata(["x/../../secret.mcap"]), "which is outside the folder"),
    "anywhere": (metadata(["/etc/passwd"]), "names /etc/passwd, which is outside the folder"),
    "a link out": (metadata(["link.mcap"]), "names link.mcap, which is outside the folder"),
    "a link out, by the other list": (metadata([], files=[{"path": "link.mcap"}]), "is outside the folder"),
    "a folder that is a link out": (metadata(["out/secret.mcap"]), "which is outside the folder"),
    "a link to itself": (metadata(["loop.mcap"]), "names loop.mcap, which is not in the folder"),
    "the folder": (metadata(["."]), "which is not in the folder"),
    "a pipe": (metadata(["pipe.mcap"]), "names pipe.mcap, which is not in the folder"),
    "what is not there": (metadata(["run_7.mcap"]), "names run_7.mcap, which is not in the folder; add the file"),
    "no name": (metadata(["a\0b"]), r"names a\x00b, which is not in the folder"),
    "too long a name": (metadata(["a" * 5000]), "is not in the folder"),
    "nothing": (metadata([]), "names no files"),
    "numbers": (metadata([], files=[{"path": [1]}, 3]), "names no files"),
    "a file twice": (metadata(["run_0.mcap", "run_0.mcap"]), "names a file twice"),
    "no MCAP": (metadata(["metadata.yaml"]), "metadata.yaml: is not an MCAP file"),
    "of something else": ("rosbag: 1", "has no rosbag2_bagfile_information"),
    "a list": ("[1, 2]", "has no rosbag2_bagfile_information"),
    "empty": ("", "has no rosbag2_bagfile_information"),
    "no YAML": ("a: 1\na: b: c", "is not YAML in line 2: mapping values are not allowed"),
    "binary": (bytes(range(256)), "is not YAML"),
    "nested without end": ("[" * 1_000_000, "is not YAML: its lists or mappings are nested too deeply"),
    "nested in blocks": ("- " * 500_000, "is not YAML: its lists or mappings are nested too deeply"),
    "a list in itself": ("a: &a [*a]\nrosbag2_bagfile_information: *a\n", "once its aliases are expanded"),
    "no character": ('a: "\\UFFFFFFFF"', "is not YAML"),
    "too large": ("# " + "x" * (4 << 20), "is larger than 1 MiB"),
    "an object": ("!!python/object/apply:os.system ['touch hacked']", "has no rosbag2_bagfile_information"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_refused(tmp_path: Path, case: str) -> None:
    text, naming = REFUSED[case]
    folder = bag(tmp_path / "run", *PARTS)
    write_mcap(tmp_path / "secret.mcap", ros2(ITEMS))
    (folder / "link.mcap").symlink_to(tmp_path / "secret.mcap")
    (folder / "out").symlink_to(tmp_path)
    (folder / "loop.mcap").symlink_to(folder / "loop.mcap")
    os.mkfifo(folder / "pipe.mcap")
    (folder / "metadata.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    refuse(tmp_path, "inspect", "run", file="run", naming=naming)


def test_aliases_without_end_are_refused(tmp_path: Path) -> None:
    lines = [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 20) if i else 'x'}]" for i in range(12)]
    folder = bag(tmp_path / "run", *PARTS)
    (folder / "metadata.yaml").write_text("\n".join([*lines, metadata(["run_0.mcap"])]))
    with pytest.raises(LogError, match="once its aliases are expanded"):
        read_log(folder)


def test_damage_names_the_file(tmp_path: Path) -> None:
    folder = bag(tmp_path / "run", *PARTS)
    path = write_mcap(folder / "run_1.mcap", ros2(PARTS[1]), use_chunking=False)
    path.write_bytes(path.read_bytes().replace(b"/joint_states", b"\xff" * 13, 1))
    with pytest.raises(LogError, match=r"run_1\.mcap: is damaged: a schema or channel cannot be read"):
        read_log(folder)
    path = write_mcap(folder / "run_1.mcap", ros2(PARTS[1]))
    path.write_bytes(path.read_bytes()[:150] + b"\xff" * 99 + path.read_bytes()[249:])
    with pytest.raises(LogError, match=r"run_1\.mcap: has a chunk at byte \d+ that is damaged"):
        read_log(folder)
    payloads = [*ros2(PARTS[1]).payloads[:9], b"\0\1", b"\0\1"]
    write_mcap(path, Channel("/joint_states", range(11), payloads))
    with pytest.raises(LogError, match="run: message 110 of /joint_states is not plain CDR"):
        read_log(folder)
