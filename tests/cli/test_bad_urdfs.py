"""URDFs that are no use: unreadable, no XML, hostile, no tree, or of another robot than the log's."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from commands import LEG, csv_text, refuse, sample_table

TEXT = LEG.read_text()
MASS, AXIS, TYPE = '<mass value="1.5"/>', '<axis xyz="1 0 0"/>', 'name="abad" type="revolute"'
BOMB = "".join(f'<!ENTITY e{i} "{f"&e{i - 1};" * 10 if i else "bomb"}">' for i in range(10))

CASES: dict[str, tuple[str | bytes, str]] = {
    "empty": ("", "is not XML"),
    "white space": ("\n\n", "is not XML"),
    "binary": (bytes(range(256)), "is not XML"),
    "zeros": (bytes(5000), "is not XML"),
    "words": ("a robot", "is not XML"),
    "cut off": (TEXT[:2000], "is not XML"),
    "a tag that is not closed": (TEXT.replace("</robot>", ""), "is not XML"),
    "two roots": (TEXT + "<robot/>", "is not XML"),
    "UTF-16": (TEXT.encode("utf-16"), "is in UTF-16"),
    "Latin-1 that says it is UTF-8": (TEXT.replace("leg", "l\xe9g").encode("latin-1"), "is not XML"),
    "HTML": ("<html><body/></html>", "<html>"),
    "SDF": ('<sdf version="1.7"><model name="leg"/></sdf>', "<sdf>"),
    "xacro": (
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="leg"><xacro:property name="a" value="1"/></robot>',
        "xacro",
    ),
    "a document type": (f"<!DOCTYPE robot>{TEXT[22:]}", "document type"),
    "an entity bomb": (f'<!DOCTYPE robot [{BOMB}]><robot name="&e9;"/>', "is not XML"),
    "an entity bomb in the text": (f"<!DOCTYPE robot [{BOMB}]><robot>&e9;</robot>", ""),
    "an entity that is a file": (
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="leg">&x;</robot>',
        "document type",
    ),
    "an entity in an attribute": ('<!DOCTYPE r [<!ENTITY x SYSTEM "file:///etc/passwd">]><r a="&x;"/>', "is not XML"),
    "tags without end": ("<robot>" + "<link>" * 100_000 + "</link>" * 100_000 + "</robot>", "is not XML"),
    "no links": ('<robot name="leg"/>', "no root link"),
    "one link": ('<robot name="leg"><link name="base"/></robot>', "no actuated joint"),
    "joints of other names": (
        TEXT.replace('"abad"', '"A"').replace('"hip"', '"B"').replace('"knee"', '"C"'),
        "the logs have abad, hip, knee",
    ),
    "only fixed joints": (TEXT.replace("revolute", "fixed"), "no actuated joint"),
    "a link that is not there": (TEXT.replace('<parent link="base"/>', '<parent link="bass"/>'), "joint abad: "),
    "a joint without a child": (TEXT.replace('<child link="shank_link"/>', ""), "joint knee: has no child link"),
    "a joint without a name": (TEXT.replace('<joint name="hip"', "<joint"), "has no name"),
    "a loop": (TEXT.replace('<parent link="base"/>', '<parent link="shank_link"/>'), "loop"),
    "two trees": (TEXT.replace("</robot>", '<link name="alone"/></robot>'), "alone"),
    "two parents": (
        TEXT.replace(
            "</robot>",
            '<joint name="again" type="fixed"><parent link="base"/><child link="foot"/></joint></robot>',
        ),
        "foot",
    ),
    "two links of one name": (TEXT.replace('<link name="foot"/>', '<link name="foot"/><link name="foot"/>'), "name"),
    "two joints of one name": (TEXT.replace('"foot_joint"', '"hip"'), "name"),
    "a type of joint that does not exist": (TEXT.replace(TYPE, 'name="abad" type="hinge"'), "joint abad: type hinge"),
    "a type that is not supported": (TEXT.replace(TYPE, 'name="abad" type="planar"'), "joint abad: type planar"),
    "a mass in words": (TEXT.replace(MASS, '<mass value="heavy"/>'), "heavy"),
    "a mass of nan": (TEXT.replace(MASS, '<mass value="nan"/>'), "link abad_link: "),
    "a mass of infinity": (TEXT.replace(MASS, '<mass value="1e999"/>'), "link abad_link: "),
    "a mass beyond all bounds": (TEXT.replace(MASS, '<mass value="1e300"/>'), "link abad_link: "),
    "an inertia that lacks a moment": (TEXT.replace('izz="0.002025"', ""), "lacks izz"),
    "an axis of zero": (TEXT.replace(AXIS, '<axis xyz="0 0 0"/>'), "joint abad: its axis is zero"),
    "an axis of two numbers": (TEXT.replace(AXIS, '<axis xyz="1 0"/>'), "joint abad: "),
    "an axis of nan": (TEXT.replace(AXIS, '<axis xyz="nan 0 0"/>'), "joint abad: "),
    "an axis beyond all bounds": (TEXT.replace(AXIS, '<axis xyz="1e300 0 0"/>'), "joint abad: "),
    "a place far away": (TEXT.replace('xyz="0 0.045 0" rpy="0 0 3', 'xyz="0 1e300 0" rpy="0 0 3'), "joint hip: "),
    "friction of nan": (TEXT.replace('friction="2.0"', 'friction="nan"'), "joint abad: "),
    "a mimic that leads nowhere": (TEXT.replace(AXIS, f'{AXIS}<mimic joint="tail"/>'), "mimics tail"),
    "a mimic of itself": (TEXT.replace(AXIS, f'{AXIS}<mimic joint="abad"/>'), "mimics abad"),
    "a name of two lines": (TEXT.replace('"abad"', '"ab&#10;ad"'), r"joint ab\nad: "),
    "a name that moves the cursor": (TEXT.replace('"thigh_link"', '"\x9b2Jthigh"'), r"link \x9b2Jthigh: "),
}


@pytest.fixture(autouse=True)
def log(tmp_path: Path) -> None:
    """A short log of the leg."""
    (tmp_path / "log.csv").write_text(csv_text(sample_table(1200)))


@pytest.mark.parametrize(("text", "naming"), CASES.values(), ids=CASES)
def test_contents(tmp_path: Path, text: str | bytes, naming: str) -> None:
    assert text != TEXT
    (tmp_path / "robot.urdf").write_bytes(text if isinstance(text, bytes) else text.encode())
    refuse(tmp_path, "fit", "robot.urdf", "log.csv", "--out", "out", file="robot.urdf: ", naming=naming)


@pytest.mark.parametrize("command", ["fit", "validate"])
def test_files(tmp_path: Path, command: str) -> None:
    refuse(tmp_path, command, "none.urdf", "log.csv", naming="none.urdf: cannot be read (No such file")


def test_a_folder(tmp_path: Path) -> None:
    refuse(tmp_path, "fit", ".", "log.csv", naming="is a folder; give a URDF")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read every file")
def test_a_file_that_must_not_be_read(tmp_path: Path) -> None:
    (tmp_path / "robot.urdf").write_text(TEXT)
    (tmp_path / "robot.urdf").chmod(0)
    refuse(tmp_path, "fit", "robot.urdf", "log.csv", naming="robot.urdf: cannot be read (Permission denied)")


def test_a_file_without_end(tmp_path: Path) -> None:
    refuse(tmp_path, "fit", "/dev/zero", "log.csv", naming="/dev/zero: is larger than 64 MiB")
