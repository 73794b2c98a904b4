"""Time of the columns of the leg's six bodies, compared with a Python loop over Pinocchio's regressor.

Run ``python benchmarks/regressor.py``. Pinocchio's model has the three links and the three rotors as six joints that
are coupled by phi = G q, so that Y = Gᵀ Y_six. Its loop is timed twice: with G applied and every Y stored, which is the
result of `LinearModel.columns`, and as bare calls whose results are discarded.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin  # type: ignore[import-untyped]
import sample_leg
import yaml
from comparison import Comparison, compare, version_text
from numpy.typing import NDArray

from idtool.dynamics.effects import RigidBodies
from idtool.dynamics.regressor import LinearModel

Array = NDArray[np.float64]

REPETITIONS = 15
CHECKED_SAMPLES = 50
JOINTS = ("abad", "hip", "knee")


def coupled_tree() -> tuple[pin.Model, Array]:
    """The leg and its rotors as joints of a tree, and G, shape (6, 3)."""
    tree = pin.buildModelFromXML(sample_leg.URDF.read_text())
    rotors = yaml.safe_load(sample_leg.CONFIG.read_text())["rotors"]
    for name, rotor in rotors.items():
        frame = tree.frames[tree.getFrameId(rotor["parent"])]
        origin = pin.SE3(pin.rpy.rpyToMatrix(*rotor["origin"]["rpy"]), np.array(rotor["origin"]["xyz"], dtype=float))
        axis = pin.JointModelRevoluteUnaligned(np.array(rotor["axis"], dtype=float))
        tree.addJoint(frame.parentJoint, axis, frame.placement * origin, name)
    ratios = [rotor["gear_ratio"] * np.equal(JOINTS, rotor["joint"]) for rotor in rotors.values()]
    return tree, np.concatenate([np.eye(3), ratios])


def comparisons() -> list[Comparison]:
    """Check that the columns are equal, and time them by turns with each of the loops."""
    experiment = sample_leg.leg_experiment()
    model = experiment.model
    linear = LinearModel(model.names, (RigidBodies(model),))
    motion = next(iter(experiment.runs[0].signals.batches())).motion
    count = len(motion.t)
    tree, G = coupled_tree()
    data = tree.createData()
    assert [*tree.names][1:] == [*JOINTS, *(body.name for body in model.bodies[3:])]
    q, v, a = (np.ascontiguousarray((G @ x).T) for x in (motion.q, motion.v, motion.a))
    Y = np.empty((count, 3, 60))

    def columns() -> object:
        return linear.columns(motion)

    def bare_calls() -> None:
        for n in range(count):
            pin.computeJointTorqueRegressor(tree, data, q[n], v[n], a[n])

    def stored_results() -> None:
        for n in range(count):
            np.matmul(G.T, pin.computeJointTorqueRegressor(tree, data, q[n], v[n], a[n]), out=Y[n])

    stored_results()
    largest = 0.0
    for j, (block, active) in enumerate(zip(linear.columns(motion), linear.active(), strict=True)):
        for n in np.linspace(0, count - 1, CHECKED_SAMPLES).astype(int):
            difference = np.abs(block[:-1, n] - Y[n, j, active]).max() / np.abs(Y[n]).max()
            largest = max(largest, float(difference))
    assert largest < 1e-10
    agreement = {"relative columns": largest}
    peer = version_text("pin")
    task = f"regressor of {count} samples, leg of 6 bodies"
    return [
        compare(task, f"loop over {peer}", columns, stored_results, REPETITIONS, agreement),
        compare(
            task,
            f"bare calls of {peer}",
            columns,
            bare_calls,
            REPETITIONS,
            agreement,
            "The loop discards its results and leaves out the coupling of rotors and joints.",
        ),
    ]


def main() -> None:
    """Print the ratios."""
    for comparison in comparisons():
        print(comparison)


if __name__ == "__main__":
    main()
