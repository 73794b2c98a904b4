"""What links carry and touch, and a base that is not level: MuJoCo has it, the entry says so."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco  # type: ignore[import-untyped]
import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import pytest
import yaml
from commands import config_with, idtool, refuse
from numpy.typing import NDArray
from prescribed_motions import silent
from robots import actuated, random_urdf
from spatial_arm import (
    ARM,
    NOISE,
    RATE,
    RIGID,
    STEPS,
    Act,
    Log,
    experiment,
    recorded,
    residual,
    residuals,
    rolled_out,
    spec_of,
    written,
)

from idtool.data.signals import Motion
from idtool.diagnosis.linearized_fit import linearize_fit
from idtool.diagnosis.trial import fit_trial, with_fixed_inertia
from idtool.dynamics.effects import effect_from_entry
from idtool.dynamics.effects.external_contact import ExternalContact
from idtool.estimation.fit import fit
from idtool.reporting.fit_report import model_config
from idtool.robot.config import EffectEntry, parse_config
from idtool.robot.model import build_model
from idtool.robot.urdf.reading import Robot

Array = NDArray[np.float64]

SECONDS = 2.0
LOAD = {"mass": 0.4, "com": [0.05, -0.02, 0.1], "inertia": [0.002, 0.0003, 0.003, -0.0002, 0.0001, 0.004]}
WINDOWS = [[0.6003, 0.9], [1.25, 1.7002]]
WRENCH = [4.0, -3.0, 5.0, 0.3, -0.2, 0.4]
POINT = [0.1, -0.05, 0.2]
PROFILE = [[0.6, 0.0], [0.75, 1.0], [0.9, 0.0], [1.25, 0.0], [1.35, -0.7], [1.5, -0.2], [1.7, 0.0]]
TILTED = [0.8, -0.5, -9.7]


def on_link(effect: str, link: str | None, **parameters: Any) -> dict[str, Any]:
    """An entry under `effects`."""
    return {"effect": effect, **({} if link is None else {"link": link}), "parameters": parameters}


def carrying(link: str, load: dict[str, Any] = LOAD) -> Log:
    """The arm with a load that its URDF has not."""
    spec = spec_of()
    body = spec.body(link).add_body(name="load")
    xx, xy, yy, xz, yz, zz = load["inertia"]
    body.explicitinertial, body.mass, body.ipos = True, load["mass"], load["com"]
    body.fullinertia = [xx, yy, zz, xy, xz, yz]
    return recorded(spec.compile(), SECONDS)


def tilted() -> Log:
    """The arm on a base that is not level."""
    spec = spec_of()
    spec.option.gravity = TILTED
    return recorded(spec.compile(), SECONDS)


def pushed(link: str) -> Log:
    """The arm with a wrench on a link, there at once and gone at once."""
    model = spec_of().compile()
    return recorded(model, SECONDS, pushing(model, link))


def pushed_by_profile() -> Log:
    """The arm with a wrench at a point of a link that comes and goes slowly."""
    model = spec_of().compile()
    body = model.body("tool").id

    def act(data: Any) -> None:
        middle = data.time + 0.5 / (RATE * STEPS) - 0.5 / RATE  # of the step; the first sample is half a sample late
        share = np.interp(middle, *np.transpose(PROFILE))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ POINT
        force, moment = share * np.array(WRENCH[:3]), share * np.array(WRENCH[3:])
        mujoco.mj_applyFT(model, data, force, moment, point, body, data.qfrc_applied)

    return recorded(model, SECONDS, act)


def pushing(model: Any, link: str) -> Act:
    """Applies the wrench by the share of each step that lies in a window; the first sample is half a sample late."""
    body, step = model.body(link).id, 1 / (RATE * STEPS)

    def act(data: Any) -> None:
        start = data.time - 0.5 / RATE
        share = sum(max(min(start + step, last) - max(start, first), 0.0) for first, last in WINDOWS) / step
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        force, moment = share * np.array(WRENCH[:3]), share * np.array(WRENCH[3:])
        mujoco.mj_applyFT(model, data, force, moment, data.xpos[body], body, data.qfrc_applied)

    return act


CASES: dict[str, tuple[Callable[[], Log], dict[str, Any]]] = {
    "payload": (lambda: carrying("fore"), on_link("payload", "fore", **LOAD)),
    "payload on a tool": (lambda: carrying("tool"), on_link("payload", "tool", **LOAD)),
    "payload on a flange without inertial": (lambda: carrying("flange"), on_link("payload", "flange", **LOAD)),
    "tilt": (tilted, on_link("gravity_tilt", None, gravity=TILTED)),
    "contact": (lambda: pushed("upper"), on_link("external_contact", "upper", windows=WINDOWS, wrench=WRENCH)),
    "contact of a tool": (lambda: pushed("tool"), on_link("external_contact", "tool", windows=WINDOWS, wrench=WRENCH)),
    "push with a profile at a point": (
        pushed_by_profile,
        on_link(
            "external_contact", "tool", windows=[[0.6, 0.9], [1.25, 1.7]], wrench=WRENCH, point=POINT, profile=PROFILE
        ),
    ),
}


@pytest.mark.parametrize(("record", "entry"), CASES.values(), ids=CASES)
def test_with_the_entry_only_noise_is_left_and_the_arm_moves_as_it_did(
    tmp_path: Path, record: Callable[[], Log], entry: dict[str, Any]
) -> None:
    """The URDF's inertias, which are the true ones; errors in units of the measured torque's noise."""
    log = record()
    with_it, without = residuals(tmp_path, log, entry)
    np.testing.assert_allclose(with_it, 1, atol=0.1)
    assert without.max() > 20
    # a contact here comes at once, there within 5 ms
    assert np.abs(rolled_out(tmp_path, log, entry)).max() < (3e-4 if "wrench" in entry["parameters"] else 1e-4)
    assert np.abs(rolled_out(tmp_path, log, seconds=0.7)).max() > 1e-3


def test_a_trial_finds_gravity_from_any_direction_and_keeps_its_size(tmp_path: Path) -> None:
    """From straight down: first-order probes are half a degree off, and other effects would explain that."""
    tried = with_fixed_inertia(experiment(*written(tmp_path, tilted()), fitted=True))
    size = float(np.linalg.norm(tried.model.gravity))
    start = EffectEntry(effect="gravity_tilt", parameters={"gravity": [0.0, 0.0, -size]})
    trial = fit_trial(linearize_fit(tried, silent), [start], [0], silent, 4)
    (found,) = trial.entries
    np.testing.assert_allclose(found.values["gravity"], size / np.linalg.norm(TILTED) * np.array(TILTED), atol=0.02)
    assert np.linalg.norm(found.values["gravity"]) == pytest.approx(size)
    assert {name for _, name in trial.standard_errors} == {"gravity.0", "gravity.1", "gravity.2"}


def test_a_load_on_a_tilted_base(tmp_path: Path) -> None:
    spec = spec_of()
    spec.option.gravity = TILTED
    spec.body("tool").add_body(name="load", explicitinertial=True, mass=0.5, ipos=[0, 0, 0.1], inertia=[0, 0, 0])
    log = recorded(spec.compile(), 1.5)
    load = on_link("payload", "tool", mass=0.5, com=[0, 0, 0.1], inertia=[0] * 6)
    entries = [load, on_link("gravity_tilt", None, gravity=TILTED)]
    for given in (entries, entries[::-1]):
        np.testing.assert_allclose(residuals(tmp_path, log, *given)[0], 1, atol=0.1)
    assert np.abs(rolled_out(tmp_path, log, *entries)).max() < 1e-4


@pytest.mark.parametrize("seed", range(4))
def test_on_robots_of_every_kind_of_joint_the_torque_is_pinocchios(seed: int, robot_of: Callable[[str], Robot]) -> None:
    """Its Jacobian, world-aligned at the link's frame; its Newton–Euler algorithm with and without the load."""
    rng = np.random.default_rng(seed)
    text = random_urdf(rng, 8, ("revolute", "prismatic", "fixed"), mimic=0.0)
    robot = robot_of(text)
    names, links = actuated(robot), list(robot.links)
    model = build_model(robot, parse_config({}, ""), names)
    witness = pin.buildModelFromXML(text)
    at = [witness.joints[witness.getJointId(name)].idx_v for name in names]
    q, v, a = rng.normal(size=(3, len(names), 5))
    given = Motion(np.full(5, 1.5), q, v, a, a, a, np.ones(len(names)), 1e-3)
    wrench = rng.normal(size=6)
    for link in links[-3:]:
        where = witness.frames[witness.getFrameId(link)]
        if not where.parentJoint:
            continue
        loaded = pin.Model(witness)
        A, com = rng.normal(size=(3, 3)), rng.normal(size=3)
        about = np.sum(A * A) * np.eye(3) - A @ A.T  # of some points
        loaded.appendBodyToJoint(where.parentJoint, pin.Inertia(2.5, com, about), where.placement)
        six = about[[0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]].tolist()
        pushed, carried = (
            effect_from_entry(EffectEntry(**entry), model)
            for entry in (
                on_link("external_contact", link, windows=[[1, 2]], wrench=wrench.tolist()),
                on_link("payload", link, mass=2.5, com=com.tolist(), inertia=six),
            )
        )
        for k in range(5):
            placed = np.zeros((3, len(names)))
            placed[:, at] = q[:, k], v[:, k], a[:, k]
            frame = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
            J = pin.computeFrameJacobian(witness, witness.createData(), placed[0], witness.getFrameId(link), frame)
            np.testing.assert_allclose(pushed.fixed_torque(given)[:, k], -(J.T @ wrench)[at], atol=1e-9)
            both, bare = (pin.rnea(m, m.createData(), *placed) for m in (loaded, witness))
            np.testing.assert_allclose(carried.fixed_torque(given)[:, k], (both - bare)[at], rtol=1e-8, atol=1e-8)


def test_windows_count_from_the_logs_first_sample(tmp_path: Path) -> None:
    log = pushed("tool")
    entry = on_link("external_contact", "tool", windows=WINDOWS, wrench=WRENCH)
    urdf, csv = written(tmp_path, {**log, "t": log["t"] + 1.7e6}, noise=NOISE)
    _, at_zero = written(tmp_path / "zero", log, noise=NOISE)
    np.testing.assert_allclose(
        residual(experiment(urdf, csv, entry)), residual(experiment(urdf, at_zero, entry)), rtol=1e-3
    )


def test_with_a_log_a_contact_acts_in_no_other(tmp_path: Path) -> None:
    """Neither along the log nor in the simulation."""
    log = pushed("tool")
    own, other = (push(log=name) for name in ("arm.csv", "leg.csv"))
    np.testing.assert_allclose(residuals(tmp_path, log, own)[0], residuals(tmp_path, log, push())[0], rtol=1e-9)
    np.testing.assert_allclose(residuals(tmp_path, log, other)[0], residuals(tmp_path, log)[0], rtol=1e-9)
    np.testing.assert_allclose(rolled_out(tmp_path, log, own), rolled_out(tmp_path, log, push()), atol=1e-9)
    np.testing.assert_allclose(rolled_out(tmp_path, log, other), rolled_out(tmp_path, log), atol=1e-9)


def test_outside_its_windows_a_contact_is_nothing(tmp_path: Path) -> None:
    urdf, csv = written(tmp_path, {name: x[:600] for name, x in recorded(spec_of().compile(), 0.6).items()})
    tried = experiment(urdf, csv, on_link("external_contact", "tool", windows=[[0.2, 0.3]], wrench=WRENCH))
    (contact,) = [effect for effect in tried.equation.effects if isinstance(effect, ExternalContact)]
    (batch,) = tried.runs[0].signals.batches()
    tau, t = contact.fixed_torque(batch.motion), batch.motion.t
    np.testing.assert_array_equal(tau[:, np.abs(t - 0.25) > 0.0525 + 1e-9], 0)
    assert (np.abs(tau[:, np.abs(t - 0.25) < 0.05]).max(axis=0) > 0.1).all()
    rise = np.abs(tau[0, np.abs(t - 0.2) < 0.0025])
    assert (np.diff(rise) > 0).all()


def test_a_fit_finds_the_link_without_its_load(tmp_path: Path) -> None:
    """The load stays an entry; the written model without it is the arm alone."""
    log = carrying("tool")
    urdf, csv = written(tmp_path, log, noise=NOISE)
    entry = on_link("payload", "tool", **LOAD)
    done = fit(experiment(urdf, csv, entry, fitted=True), lambda stage, share: None)
    assert model_config(done)["effects"] == [entry]
    prior, found = done.experiment.equation.prior, done.estimate.theta
    np.testing.assert_allclose(found, prior, atol=0.02)
    assert done.train.errors["identified"].rms(done.experiment.equation.joints)["overall"] < 1.1 * NOISE
    bare = recorded(spec_of().compile(), 1.5)
    command = ["fit", urdf, csv, "--config", config_with(tmp_path / "c.yaml", **RIGID, effects=[entry]), "--quiet"]
    assert idtool(*command, "--no-simulation", "--out", tmp_path / "out").code == 0
    _, alone = written(tmp_path / "bare", bare, noise=NOISE)
    config = config_with(tmp_path / "bare.yaml", tmp_path / "out" / "model.yaml", effects=[])
    arguments = ["validate", tmp_path / "out" / "identified.urdf", alone, "--config", config, "--out", tmp_path / "v"]
    assert idtool(*arguments, "--quiet", "--max-rms", 0.5 * NOISE).code == 0


def test_every_command_takes_the_entries_and_the_model_keeps_them(tmp_path: Path) -> None:
    spread = {"value": LOAD["mass"], "standard_error": 0.01}
    entries = [
        on_link("payload", "tool", **{**LOAD, "mass": spread, "com": [0.05, {"value": -0.02}, 0.1]}),
        on_link("external_contact", "flange", windows=WINDOWS, wrench=WRENCH),
        on_link("external_contact", "flange", windows=[[0.1, 0.2]], wrench=WRENCH),
        on_link("external_contact", "tool", windows=WINDOWS, wrench=WRENCH, point=POINT, profile=PROFILE, log="b.csv"),
        on_link("gravity_tilt", None, gravity=TILTED),
    ]
    urdf, csv = written(tmp_path, recorded(spec_of().compile(), 0.6))
    config = config_with(tmp_path / "given.yaml", **RIGID, effects=entries)
    done = idtool("fit", urdf, csv, "--config", config, "--out", tmp_path / "out", "--quiet", "--no-simulation")
    assert done.code == 0, done.err
    model = tmp_path / "out" / "model.yaml"
    assert yaml.safe_load(model.read_text())["effects"] == entries
    for command, out in ((["validate", "--no-simulation"], "again"), (["simulate"], "simulated.csv")):
        identified = tmp_path / "out" / "identified.urdf"
        done = idtool(*command, identified, csv, "--config", model, "--out", tmp_path / out, "--quiet")
        assert done.code == 0, done.err


def load(**changed: Any) -> dict[str, Any]:
    """A payload on the tool with something else."""
    return on_link("payload", "tool", **{**LOAD, **changed})


def push(**changed: Any) -> dict[str, Any]:
    """A contact of the tool with something else."""
    return on_link("external_contact", "tool", **{"windows": WINDOWS, "wrench": WRENCH, **changed})


BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no link": (on_link("payload", None, **LOAD), "payload: acts on a link; give `link` and not `joint`"),
    "a joint": ({**load(), "joint": "lift"}, "payload: acts on a link; give `link` and not `joint`"),
    "an unknown link": (
        on_link("payload", "tol", **LOAD),
        "payload: tol is not a link of the URDF; did you mean tool?",
    ),
    "the base": (
        on_link("payload", "base", **LOAD),
        "payload: link base is not moved by any joint; name a moving link",
    ),
    "a parameter missing": (
        on_link("payload", "tool", mass=1, com=[0, 0, 0]),
        "payload: needs the parameters mass, com",
    ),
    "no mass": (load(mass=0), "payload: mass of 0 is not possible; give a value above 0"),
    "a centre in a plane": (load(com=[0, 0]), "payload: com is not a list of 3 numbers"),
    "a centre of words": (load(com=["a", "b", "c"]), "payload: com is not a list of 3 numbers"),
    "an inertia of nine": (load(inertia=[0] * 9), "payload: inertia is not a list of 6 numbers"),
    "no body's inertia": (load(inertia=[1, 0, 1, 0, 0, 3]), "payload: inertia is not realizable"),
    "a negative inertia": (load(inertia=[-1, 0, 1, 0, 0, 1]), "payload: inertia is not realizable"),
    "windows that are numbers": (push(windows=[0, 1]), "external_contact: windows is not a list of lists of 2 numbers"),
    "no windows": (push(windows=[]), "external_contact: windows is not a list of lists of 2 numbers"),
    "a window backwards": (push(windows=[[1, 0]]), "external_contact: windows must be in ascending order"),
    "a log without a name": (push(log=1), "external_contact: log is not text; give the file name of a log"),
    "a point in a plane": (push(point=[0, 0]), "external_contact: point is not a list of 3 numbers"),
    "a profile of numbers": (push(profile=[0, 1]), "external_contact: profile is not a list of lists of 2 numbers"),
    "a profile backwards": (push(profile=[[1, 0], [0, 1]]), "external_contact: the times of the profile must be in"),
    "windows that touch": (push(windows=[[0, 1], [1, 2]]), "external_contact: windows must be in ascending order"),
    "a tilt of a link": (on_link("gravity_tilt", "tool", gravity=TILTED), "gravity_tilt: acts on the whole robot"),
    "a tilt in degrees": (on_link("gravity_tilt", None, gravity=5), "gravity_tilt: gravity is not a list of 3 numbers"),
}


@pytest.mark.parametrize(("bad", "message"), BAD.values(), ids=BAD)
def test_a_bad_entry_is_refused(tmp_path: Path, bad: dict[str, Any], message: str) -> None:
    urdf, csv = written(tmp_path, resting())
    config_with(tmp_path / "arm.yaml", effects=[bad])
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=message)


def resting() -> Log:
    """A log that is read before anything is asked of it."""
    return {"t": np.arange(300) / RATE, **{name: np.zeros((300, 3)) for name in ("q", "v", "tau")}}


def test_links_behind_a_joint_that_is_held_still(tmp_path: Path) -> None:
    """With an inertial their place is known; without it is not."""
    text = ARM.replace('name="end" type="fixed"', 'name="end" type="revolute"')
    log = resting()
    urdf, csv = written(tmp_path, log, text=text)
    tool = experiment(urdf, csv, load(), locked_joints={"end": 0.4}).equation.effects[-1]
    assert tool.frame.body == 2  # type: ignore[attr-defined]
    config_with(tmp_path / "arm.yaml", effects=[on_link("payload", "flange", **LOAD)])
    said = "payload: link flange is carried by joint end, which is locked; name the parent link of this joint"
    refuse(tmp_path, "fit", urdf, csv, "--out", "out", naming=said)


def test_a_link_has_one_load_and_a_base_one_gravity(tmp_path: Path) -> None:
    urdf, csv = written(tmp_path, resting())
    for twice, on in (
        (load(), " for tool"),
        (push(), " for tool"),
        (on_link("gravity_tilt", None, gravity=TILTED), ""),
    ):
        folder = tmp_path / twice["effect"]
        folder.mkdir()
        config = config_with(tmp_path / "twice.yaml", effects=[twice, twice])
        said = f"effects: {twice['effect']}: is listed twice{on}; keep one entry"
        refuse(folder, "fit", urdf, csv, "--config", config, "--out", "out", naming=said)
