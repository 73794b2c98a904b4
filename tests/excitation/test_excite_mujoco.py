"""The paper's leg in MuJoCo along a designed trajectory: what was predicted comes true, and it beats other motions.

The leg's true parameters are not those that the design knew; MuJoCo simulates it under a PD controller, with an encoder
and noisy torque. A minute and more, so not part of CI.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import LEG
from exciting import excited
from leg_motions import Motion, shell
from leg_runs import run_leg
from leg_truth import true_theta
from numpy.typing import NDArray

from idtool.data.logs import JointLog, read_log, write_log
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.dataset.weights import free_noise
from idtool.estimation.uncertainty.base_parameters import structural_base_parameters
from idtool.estimation.uncertainty.standard_errors import least_squares_uncertainty
from idtool.excitation.criteria import BaseColumns
from idtool.robot.config import read_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

SECONDS = 20.0
NOISE = 0.4 * np.sqrt(2 * 40 / 1000) * 0.94  # N·m: the sensor's, below 40 Hz; the filter passes 0.94² of a box's power

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def designed(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], JointLog]:
    """A design with the command's own settings."""
    folder = tmp_path_factory.mktemp("designed")
    return excited(folder, LEG, "--noise", f"{NOISE}", "--duration", f"{SECONDS}", "--iterations", "200")


def experiment(folder: Path, log: JointLog) -> Experiment:
    """The log as `fit` reads it."""
    path = folder / "run.mcap"
    write_log(path, log)
    return prepare(read_robot(LEG), read_config(LEG.with_suffix(".yaml")), [path], holdout=0.0)


def realised(folder: Path, log: JointLog) -> tuple[Array, Array]:
    """Standard errors of the base parameters by what `fit` believes, and how far they are from the truth, (r,) each."""
    run = experiment(folder, log)
    reduction = run.reduce(lambda stage, share: None)
    noise = free_noise(run.equation, reduction, run.equalities)
    base = structural_base_parameters(run.model, run.equation, run.equalities)
    believed = least_squares_uncertainty(run.equation, reduction, noise, run.equalities).of(base.B)
    W = BaseColumns(run.equation, base, run.equalities).rows(reduction, noise)
    tau = np.concatenate(
        [f.R[:, -1] * np.sqrt(f.independent / f.rows) / s for f, s in zip(reduction, noise, strict=True)]
    )
    size = np.linalg.norm(W, axis=0)
    found = np.linalg.lstsq(W / size, tau, rcond=None)[0] / size
    return believed, found - base.B @ true_theta(run)


def mean(x: Array) -> float:
    return float(np.exp(np.log(x).mean()))


def commanded(log: JointLog, seed: int) -> JointLog:
    return run_leg(log.signals["qcmd"], log.signals["vcmd"], seed)


def run(motion: Motion, seed: int) -> JointLog:
    return run_leg(motion.q, motion.v, seed, acmd=motion.a)


def test_realised_standard_errors_are_the_predicted_ones(
    tmp_path: Path, designed: tuple[dict[str, Any], JointLog]
) -> None:
    report, log = designed
    predicted = np.array([p["standard_error"] for p in report["base_parameters"]])
    results = [realised(tmp_path, commanded(log, seed)) for seed in range(4)]
    for believed, _ in results:
        assert believed == pytest.approx(predicted, rel=0.3)
    # and what they are off by is of that size: 4 runs of 38 parameters
    off = np.array([error for _, error in results]) / predicted
    assert 0.8 < np.sqrt(np.square(off).mean()) < 1.4


def test_limits_are_kept_by_the_leg(designed: tuple[dict[str, Any], JointLog]) -> None:
    report, log = designed
    run = commanded(log, 1)
    for j, name in enumerate(run.joints):
        limits = report["limits"][name]
        assert limits["position"][0] < run.signals["q"][:, j].min()
        assert run.signals["q"][:, j].max() < limits["position"][1]
        assert np.abs(run.signals["v"][:, j]).max() < limits["velocity"]
        assert np.abs(run.signals["tau"][:, j]).max() < limits["effort"]


def test_twice_as_good_as_the_papers_shell(tmp_path: Path, designed: tuple[dict[str, Any], JointLog]) -> None:
    own = mean(realised(tmp_path, commanded(designed[1], 1))[0])
    assert mean(realised(tmp_path, run(shell(SECONDS), 1))[0]) > 2 * own


def random_series(report: dict[str, Any], seed: int, harmonics: int) -> Motion:
    """Random sines of 0.1 Hz and its multiples, each joint's scaled until it uses as much of a limit as the design."""
    rng = np.random.default_rng(seed)
    limits = [report["limits"][joint] for joint in ("abad", "hip", "knee")]
    w, t = 0.2 * np.pi * np.arange(1, harmonics + 1), np.arange(round(1000 * SECONDS)) / 1000
    amplitude = rng.normal(size=(3, harmonics)) / w
    angle = w[:, None] * t + rng.uniform(0, 2 * np.pi, (3, harmonics))[..., None]
    q, v, a = (np.einsum("jh,jhn->nj", w**k * amplitude, np.sin(angle + k * np.pi / 2)) for k in range(3))
    low, high = np.transpose([joint["position"] for joint in limits])
    most = [0.9 * np.array([joint[name] for joint in limits]) for name in ("velocity", "acceleration")]
    room = 0.9 * (high - low) / np.ptp(q, axis=0)
    scale = np.minimum.reduce([room, most[0] / np.abs(v).max(axis=0), most[1] / np.abs(a).max(axis=0)])
    middle = (q.max(axis=0) + q.min(axis=0)) / 2
    return Motion((low + high) / 2 + scale * (q - middle), scale * v, scale * a)


@pytest.mark.parametrize(("harmonics", "better"), [(5, 3.0), (15, 3.0), (30, 2.0)])
def test_better_than_random_fourier_series_within_the_same_limits(
    tmp_path: Path, designed: tuple[dict[str, Any], JointLog], harmonics: int, better: float
) -> None:
    """How much depends on the series: the more of its harmonics are high, the more it too makes of the limits."""
    own = mean(realised(tmp_path, commanded(designed[1], 1))[0])
    for seed in range(3):
        motion = random_series(designed[0], seed, harmonics)
        assert mean(realised(tmp_path, run(motion, seed))[0]) > better * own


def test_the_command_that_is_written_is_read_back(designed: tuple[dict[str, Any], JointLog]) -> None:
    assert len(read_log(designed[0]["file"])) == SECONDS * 1000 + 1
