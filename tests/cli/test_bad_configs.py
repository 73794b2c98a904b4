"""Configurations that are no use, through the command line: keys at every depth, names that the URDF has not, numbers.

What a configuration may hold by itself is tested value by value in test_config.py.
"""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from commands import LEG, csv_text, idtool, refuse, sample_table

LEG_YAML = yaml.safe_load(LEG.with_suffix(".yaml").read_text())
SPRING = {"effect": "parallel_spring", "joint": "hip", "parameters": {"stiffness": 1.0, "rest_position": 0.0}}
ROTOR = "rotors.hip_rotor"
BODIES = ("abad_link", "thigh_link", "shank_link", "abad_rotor", "hip_rotor", "knee_rotor")
BOMB = "".join(
    f"{name}: &{name} [{', '.join([f'*{before}'] * 9)}]\n" for before, name in zip("abcdefgh", "bcdefghi", strict=True)
)

FILES: dict[str, tuple[str | bytes, str]] = {
    "binary": (bytes(range(256)), "is not YAML"),
    "not YAML": (
        "joints: [hip",
        "is not YAML in line 1: expected ',' or ']', but got '<stream end>'; correct it there",
    ),
    "two documents": ("{}\n---\n{}", "is not YAML"),
    "a list": ("[joints, rotors]", "is not a configuration"),
    "a word": ("leg", "is not a configuration"),
    "a URDF": (LEG.read_text(), "is not "),
    "a key twice": ("seed: 1\nvelocity: auto\nseed: 2\n", "duplicate key 'seed' in line 3"),
    "a key twice, deep down": ("filter: {order: 4, order: 2}", "duplicate key 'order'"),
    "an alias bomb": (f"a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n{BOMB}", "aliases are expanded"),
    "an alias to itself": ("joints: &a [*a]", "aliases are expanded"),
    "a tag that runs a command": ("joints: !!python/object/apply:os.system ['touch owned']", "is not YAML in line 1"),
    "a megabyte": ("#" * (2 << 20), "is larger than 1 MiB"),
    "a number without end": ("seed: " + "9" * 100_000, "characters in line 1"),
}

KEYS: dict[str, tuple[str, Any, str]] = {
    # where to put what, and what is to be named
    "unknown": ("jonts", ["hip"], "unknown key 'jonts'; did you mean 'joints'?"),
    "unknown in log": ("log.topc", "/a", "log: unknown key 'topc'; did you mean 'topic'?"),
    "unknown in filter": ("filter.cutoff", 30, "filter: unknown key 'cutoff'; did you mean 'cutoff_hz'?"),
    "unknown in friction": ("friction.viscos", True, "friction: unknown key 'viscos'; did you mean 'viscous'?"),
    "unknown in a rotor": (f"{ROTOR}.gear", 9, f"{ROTOR}: unknown key 'gear'; did you mean 'gear_ratio'?"),
    "unknown in its origin": (f"{ROTOR}.origin.xzy", [0, 0, 0], f"{ROTOR}.origin: unknown key 'xzy'"),
    "unknown in its inertial": (
        f"{ROTOR}.inertial.mas",
        1,
        f"{ROTOR}.inertial: unknown key 'mas'; did you mean 'mass'?",
    ),
    "unknown in an ellipsoid": (
        "bounding_ellipsoids.thigh_link",
        [{"centre": [0, 0, 0], "semi_axes": [1, 1, 1]}],
        "bounding_ellipsoids.thigh_link.0: unknown key 'centre'; did you mean 'center'?",
    ),
    "unknown in an effect": ("effects", [{**SPRING, "joints": "hip"}], "effects.0: unknown key 'joints'"),
    "unknown signal to scale": ("log.scale", {"torque": {"hip": 1}}, "log.scale: unknown key 'torque'; did you mean"),
    "known: an unknown body": (
        "known",
        {"mass": {"thigh": 0.6}},
        "thigh: is not a body of the model (a body includes the links fixed to it); did you mean thigh_link?",
    ),
    "known: a lumped link": ("known", {"mass": {"foot": 0.06}}, "known.mass: foot: is not a body of the model"),
    "known: a negative mass": ("known", {"mass": {"thigh_link": -0.6}}, "known.mass.thigh_link.value: "),
    "known: a mass of nothing": ("known", {"total_mass": 0}, "known.total_mass.value: "),
    "known: contradicting masses": (
        "known",
        {"mass": dict.fromkeys(BODIES, 0.5), "total_mass": 4},
        "contradicts another exactly known value; give one of them a standard_error",
    ),
    "known: masses beyond their total": (
        "known",
        {"mass": {"thigh_link": 3, "shank_link": 2}, "total_mass": 1},
        "solver: found ",
    ),
    "known_com: an unknown body": ("known_com", {"thigh": [0, 0, 0]}, "known_com: thigh: is not a body of the model"),
    "known_com: outside the ellipsoid": ("known_com", {"thigh_link": [9, 0, 0]}, "solver: found no parameters"),
    "mirror: itself": (
        "mirror",
        [{"body": "hip_rotor", "of": "hip_rotor"}],
        "mirror.0: hip_rotor cannot be a copy of itself",
    ),
    "mirror: a circle": (
        "mirror",
        [{"body": "hip_rotor", "of": "knee_rotor"}, {"body": "knee_rotor", "of": "hip_rotor"}],
        "is a copy of itself through others; remove one entry",
    ),
    "mirror: of two": (
        "mirror",
        [{"body": "hip_rotor", "of": "knee_rotor"}, {"body": "hip_rotor", "of": "abad_rotor"}],
        "mirror: hip_rotor: is given as a copy of two others; keep one entry",
    ),
    "mirror: an unknown body": (
        "mirror",
        [{"body": "hip_roter", "of": "knee_rotor"}],
        "mirror: hip_roter: is not a moving body of the model; did you mean hip_rotor?",
    ),
    "mirror: of an unknown joint": (
        "mirror",
        [{"joint": "hip", "of": "knees"}],
        "mirror: knees: is not a moving joint of the model; did you mean knee?",
    ),
    "mirror: a joint in a plane": (
        "mirror",
        [{"joint": "hip", "of": "knee", "plane": "xz"}],
        "mirror.0: plane is only for",
    ),
    "SI units with an entropic prior": (
        "regularization",
        {"kind": "entropic", "units": "si"},
        "regularization: units: si is only for kind: euclidean",
    ),
    "shapes: an unknown kind": (
        "bounding_shapes",
        {"thigh_link": [{"kind": "cone", "radius": 1}]},
        "bounding_shapes.thigh_link.0: needs a kind that is one of box, cylinder, capsule, hull, not cone",
    ),
    "shapes: an unknown link": (
        "bounding_shapes",
        {"thigh": [{"kind": "box", "size": [1, 1, 1]}]},
        "bounding_shapes: thigh: is not a link of the URDF; did you mean thigh_link?",
    ),
    "shapes: a mesh that is not there": (
        "bounding_shapes",
        {"thigh_link": [{"kind": "hull", "file": "thigh.stl"}]},
        "thigh.stl",
    ),
    "a signal scaled by 0": ("log.scale", {"tau": {"hip": 0}}, "log.scale.tau.hip: a scale of 0 removes the signal"),
    "a joint twice": ("joints", ["hip", "knee", "hip"], "joints: hip is listed twice; list each joint once"),
    "negative friction": ("friction", {"coulomb": -0.1}, "friction.coulomb: friction of -0.1 would drive the joint"),
    "no kind of regularization": ("regularization.kind", "ridge", "regularization.kind: "),
    "no constraint set": ("constraints", "tight", "constraints: "),
    "no solver": ("solver.name", "mosek", "solver.name: "),
    "joints that are no list": ("joints", "hip", "joints: "),
    "rotors that are a list": ("rotors", [], "rotors: "),
    "gravity of two numbers": ("gravity", [0, -9.81], "gravity.2: "),
    "gravity of nan": ("gravity", [0, 0, float("nan")], "gravity.2: "),
    "gravity beyond all bounds": ("gravity", [0, 0, 1e300], "gravity.2: "),
    "a negative weight": ("regularization.weight", -1e-6, "regularization.weight: "),
    "a cut-off of 0": ("filter.cutoff_hz", 0, "filter.cutoff_hz: "),
    "a cut-off above Nyquist": ("filter.cutoff_hz", 600, "filter.cutoff_hz: 600 Hz is too high"),
    "a cut-off below the log": ("filter.cutoff_hz", 0.1, "log.csv: lasts 1.2 s, less than a period of the 0.1 Hz"),
    "a cut-off that would take all memory": ("filter.cutoff_hz", 1e-9, "log.csv: lasts 1.2 s"),
    "an order of 0": ("filter.order", 0, "filter.order: "),
    "a window of 0": ("simulation.window", 0, "simulation.window: "),
    "a gear ratio of 0": (f"{ROTOR}.gear_ratio", 0, f"{ROTOR}: a gear ratio of 0"),
    "a gear ratio in words": (f"{ROTOR}.gear_ratio", "ten", f"{ROTOR}.gear_ratio: "),
    "a gear ratio beyond all bounds": (f"{ROTOR}.gear_ratio", 1e200, f"{ROTOR}.gear_ratio: "),
    "both gear ratio and coupling": (f"{ROTOR}.coupling", {"knee": 1}, f"{ROTOR}: give either"),
    "an axis of zero": (f"{ROTOR}.axis", [0, 0, 0], f"{ROTOR}: axis must not be zero"),
    "an axis that is as good as zero": (f"{ROTOR}.axis", [1e-300, 0, 0], f"{ROTOR}: axis must not be zero"),
    "a rotor without inertial": (f"{ROTOR}.inertial", None, f"{ROTOR}.inertial: is missing"),
    "a rotor of negative mass": (f"{ROTOR}.inertial.mass", -0.5, f"{ROTOR}.inertial.mass: "),
    "a rotor's inertia of five numbers": (
        f"{ROTOR}.inertial.inertia",
        [1, 0, 1, 0, 0],
        f"{ROTOR}.inertial.inertia.5: ",
    ),
    "a negative semi-axis": (f"{ROTOR}.bounding_ellipsoid.semi_axes", [0.1, -0.1, 0.1], "semi_axes.1: "),
    "a semi-axis of nothing": (f"{ROTOR}.bounding_ellipsoid.semi_axes", [1e-200, 1, 1], "semi_axes.0: "),
    "an ellipsoid too small for its link": (
        "bounding_ellipsoids.thigh_link",
        [{"center": [1e6, 0, 0], "semi_axes": [1e-6, 1e-6, 1e-6]}],
        "thigh_link: mass within its bounding ellipsoid: the problem was not solved accurately enough",
    ),
    "joints: an unknown joint": (
        "joints",
        ["abad", "hipp", "knee"],
        "joints: hipp: is not an actuated joint of the URDF; did",
    ),
    "joints: a fixed joint": ("joints", ["hip", "foot_joint"], "joints: foot_joint: "),
    "joints: none": ("joints", [], "leg.urdf: "),
    "locked: an unknown joint": ("locked_joints", {"tail": 0.0}, "locked_joints: tail: is not an actuated joint"),
    "locked: a moving joint": ("locked_joints", {"hip": 0.0}, "locked_joints: hip: is also listed as a moving joint"),
    "locked: a joint of two lines": ("locked_joints", {"a\nb": 0.0}, r"locked_joints: a\nb: "),
    "locked: nowhere, of two lines": ("locked_joints", {"a\nb": "x"}, r"locked_joints.a\nb: "),
    "rotors: an unknown joint": (f"{ROTOR}.joint", "hipp", f"{ROTOR}: hipp is not a moving joint; did you mean hip?"),
    "rotors: an unknown parent": (f"{ROTOR}.parent", "torso", f"{ROTOR}.parent: torso is not a link"),
    "rotors: a moving link's name": ("rotors.thigh_link", {"joint": "hip", "gear_ratio": 9}, "rotors.thigh_link: "),
    "rotors: a name that moves the cursor": ("rotors.a\x1b[2J", LEG_YAML["rotors"]["hip_rotor"], r"rotors.a\x1b[2J: "),
    "ellipsoids: an unknown link": (
        "bounding_ellipsoids.thigh",
        [{"semi_axes": [1, 1, 1]}],
        "bounding_ellipsoids: thigh: is not a link of the URDF; did you mean thigh_link?",
    ),
    "friction: an unknown joint": ("friction", {"hipp": {"viscous": True}}, "friction: hipp: "),
    "friction: a fixed joint": ("friction", {"foot_joint": {"viscous": True}}, "friction: foot_joint: "),
    "friction: a value in words": ("friction.coulomb", "dry", "friction.coulomb"),
    "effects: an unknown effect": ("effects", [{**SPRING, "effect": "paralel_spring"}], "effects: paralel_spring: "),
    "effects: an unknown joint": ("effects", [{**SPRING, "joint": "hipp"}], "effects: parallel_spring: hipp is no"),
    "effects: no joint": ("effects", [{**SPRING, "joint": None}], "effects: parallel_spring: acts on a joint"),
    "effects: a link": ("effects", [{**SPRING, "link": "thigh_link"}], "effects: parallel_spring: acts on a joint"),
    "effects: a parameter is missing": ("effects", [{**SPRING, "parameters": {"stiffness": 1}}], "rest_position"),
    "effects: a parameter in words": (
        "effects",
        [{**SPRING, "parameters": {"stiffness": "soft", "rest_position": 0}}],
        "effects: parallel_spring: ",
    ),
    "controller: an unknown joint in kp": ("controller", {"kp": {"hipp": 20}}, "controller.kp: hipp: "),
    "controller: an unknown joint in kd": (
        "controller",
        {"kp": {"hip": 20}, "kd": {"knees": 1}},
        "controller.kd: knees: ",
    ),
    "controller: no kp": ("controller", {"kd": {"hip": 1}}, "controller.kp: "),
    "controller: a negative gain": ("controller", {"kp": {"hip": -20}}, "controller.kp.hip: "),
    "controller: a negative delay": ("controller", {"kp": {"hip": 20}, "delay": -1}, "controller.delay: "),
}


@pytest.fixture(autouse=True)
def log(tmp_path: Path) -> None:
    """A short log of the leg."""
    (tmp_path / "log.csv").write_text(csv_text(sample_table(1200)))


@pytest.mark.parametrize("command", ["fit", "validate", "inspect"])
@pytest.mark.parametrize(("text", "naming"), FILES.values(), ids=FILES)
def test_files(tmp_path: Path, command: str, text: str | bytes, naming: str) -> None:
    (tmp_path / "bad.yaml").write_bytes(text if isinstance(text, bytes) else text.encode())
    urdf = [] if command == "inspect" else [LEG, "--out", "out"]
    refuse(tmp_path, command, *urdf, "log.csv", "--config", "bad.yaml", file="bad.yaml: ", naming=naming)


@pytest.mark.parametrize(("place", "value", "naming"), KEYS.values(), ids=KEYS)
def test_keys(tmp_path: Path, place: str, value: object, naming: str) -> None:
    data = copy.deepcopy(LEG_YAML)
    holder, (*parents, key) = data, place.split(".")
    for parent in parents:
        holder = holder.setdefault(parent, {})
    holder[key] = value
    (tmp_path / "bad.yaml").write_text(yaml.safe_dump(data))
    refuse(tmp_path, "fit", LEG, "log.csv", "--config", "bad.yaml", "--out", "out", naming=naming)


def test_the_config_itself_can_be_used(tmp_path: Path) -> None:
    data = {**LEG_YAML, "effects": [SPRING]}
    (tmp_path / "good.yaml").write_text(yaml.safe_dump(data))
    assert idtool("fit", LEG, "log.csv", "--config", "good.yaml", "--quiet", folder=tmp_path).code == 0


def test_the_config_beside_the_urdf_is_held_to_the_same(tmp_path: Path) -> None:
    (tmp_path / "leg.urdf").write_text(LEG.read_text())
    (tmp_path / "leg.yaml").write_text("jonts: [hip]")
    naming = "leg.yaml: unknown key 'jonts'; did you mean 'joints'?"
    refuse(tmp_path, "fit", "leg.urdf", "log.csv", "--out", "out", naming=naming)
