"""The study of the sample leg: the paper's Table I, Fig. 5 and Remark 5, and that the report says what was found."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import JOINTS, LEG, SAMPLES, TRAIN, VALIDATE, numbers
from numpy.typing import NDArray

from idtool.common.exceptions import ConfigError
from idtool.estimation.dataset.experiment import Experiment, prepare
from idtool.estimation.fit import fit
from idtool.estimation.problem.certificate import GAP
from idtool.estimation.study import study as module
from idtool.estimation.study.study import Study, study
from idtool.reporting.study_report import study_report
from idtool.robot.config import WEAK_PRIOR, parse_config, read_config
from idtool.robot.inertia import PARAMETER_NAMES, PI_SIZE, from_mass_com_inertia, pseudo_inertia, symmetric_matrix
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

LEG_YAML = LEG.with_suffix(".yaml")
ORDER = ("none", "semi", "full", "com_ellipsoid", "ellipsoid")  # from the loosest, each within the one before
CURVES = ("none", "semi", "full", "ellipsoid")
DRAWS = 6


def silent(stage: str, share: float) -> None:
    """No progress."""


@pytest.fixture(scope="module")
def patch() -> Iterator[pytest.MonkeyPatch]:
    with pytest.MonkeyPatch.context() as patch:
        yield patch


@pytest.fixture(scope="module")
def leg() -> Experiment:
    """The sample leg with a log to fit and one held out."""
    return prepare(read_robot(LEG), read_config(LEG_YAML), [TRAIN], [VALIDATE])


@pytest.fixture(scope="module")
def result(leg: Experiment, patch: pytest.MonkeyPatch) -> Study:
    """Its study, each problem solved once."""
    patch.setattr(module, "_REPEATS", 1)
    return study(leg, silent, DRAWS)


@pytest.fixture(scope="module")
def report(result: Study) -> dict[str, Any]:
    """Its report, by way of JSON."""
    data: dict[str, Any] = json.loads(json.dumps(study_report(result).to_json(), allow_nan=False))
    return data


def at(report: dict[str, Any], count: int) -> dict[str, float]:
    """Median error of each curve at a number of samples."""
    k = report["learning"]["counts"].index(count)
    return {name: curve["median"][k] for name, curve in report["learning"]["curves"].items()}


def test_a_tighter_set_needs_fewer_samples(report: dict[str, Any]) -> None:
    """The order of the paper's Fig. 5 where there are fewer samples than parameters and not next to none."""
    medians = at(report, 30)
    assert medians["ellipsoid"] <= 1.02 * medians["full"]
    assert medians["full"] <= 1.02 * medians["none"]
    assert medians["ellipsoid"] < 0.95 * medians["none"]


def test_with_all_samples_the_sets_are_as_good(report: dict[str, Any]) -> None:
    counts = report["learning"]["counts"]
    assert counts == sorted(set(counts))
    assert counts[0] == 1
    last = at(report, counts[-1])
    assert max(last.values()) < 1.02 * min(last.values())
    first = at(report, 1)
    assert min(first.values()) > 5 * max(last.values())
    for name, curve in report["learning"]["curves"].items():
        assert curve["median"][-1] == pytest.approx(report["sets"][name]["rms"]["validation"]["overall"], rel=0.01)


def test_few_samples_without_constraints_give_bodies_that_cannot_be(report: dict[str, Any]) -> None:
    violations = report["learning"]["violation"]
    k = report["learning"]["counts"].index(30)
    assert violations["none"][k] > 0.1
    assert violations["semi"][k] > 0
    for name in ("full", "ellipsoid"):
        assert violations[name] == [0.0] * len(violations[name])


def test_quartiles_lie_about_the_median(report: dict[str, Any]) -> None:
    learning = report["learning"]
    assert (tuple(learning["curves"]), learning["draws"], learning["unit_overall"]) == (CURVES, DRAWS, "N·m")
    for curve in learning["curves"].values():
        lower, median, upper = (np.array(curve[key]) for key in ("lower", "median", "upper"))
        assert len(median) == len(learning["counts"])
        assert (lower <= median).all()
        assert (median <= upper).all()
        assert upper[-1] - lower[-1] < 1e-3 * median[-1]
        assert upper[1] - lower[1] > 1e-2 * median[1]


@pytest.fixture(scope="module")
def fitted(leg: Experiment) -> Any:
    """What `idtool fit` makes of the same data with the prior that a study takes."""
    return fit(replace(leg, config=leg.config.model_copy(update={"regularization": WEAK_PRIOR})), silent)


def test_every_set_predicts_as_well_as_the_fit(report: dict[str, Any], fitted: Any) -> None:
    fits = {
        "train": fitted.train.errors["identified"].rms(JOINTS),
        "validation": fitted.validation.errors["identified"].rms(JOINTS),
    }
    assert set(report["sets"]) == {*ORDER, "points"}
    for name, row in report["sets"].items():
        for part, rms in fits.items():
            assert set(row["rms"][part]) == {*JOINTS, "overall"}
            for joint, value in row["rms"][part].items():
                assert value == pytest.approx(rms[joint], rel=0.02 if name in ORDER else 0.1)
    for part, rms in fits.items():
        assert report["sets"]["ellipsoid"]["rms"][part] == pytest.approx(rms, rel=1e-5)


def test_a_tighter_set_costs_no_less_and_the_true_one_no_more(report: dict[str, Any]) -> None:
    """The bodies that made the data are in every set but `points`."""
    costs = [report["sets"][name]["objective"] for name in ORDER]
    assert all(tighter >= looser * (1 - 2 * GAP) for looser, tighter in pairwise(costs))
    assert costs[-1] < costs[0] * (1 + 1e-3)


def test_every_set_is_certified(report: dict[str, Any]) -> None:
    for row in report["sets"].values():
        assert abs(row["duality_gap"]) <= GAP
        assert row["seconds"] > 0
        assert row["iterations"] > 0
    for name in ("euclidean", "pullback", "entropic"):
        assert abs(report["estimators"][name]["duality_gap"]) <= GAP
        assert (report["estimators"][name]["status"], report["estimators"][name]["note"]) == ("optimal", "")


def test_bodies_that_cannot_be_are_counted(report: dict[str, Any], result: Study) -> None:
    """By the eigenvalues of what was found, each in units of a body's own mass and size."""
    units = np.array([c.scale for c in result.experiment.equation.coefficients[: PI_SIZE * 6]], dtype=float)
    for name, row in report["sets"].items():
        bodies = (result.sets[name].theta[: PI_SIZE * 6] / units).reshape(6, PI_SIZE)
        least = np.linalg.eigvalsh(pseudo_inertia(bodies))[:, 0]
        assert row["violations"] == np.count_nonzero(least < 0)
        assert row["worst_margin"] == pytest.approx(least.min(), rel=1e-9, abs=1e-15)
        assert (row["violations"] > 0) is (name in ("none", "semi"))
        assert set(row["masses"]) == {body.name for body in result.experiment.model.bodies}
        for i, mass in enumerate(row["masses"].values()):
            assert mass == result.sets[name].theta[PI_SIZE * i]


def test_inequalities_are_of_the_sizes_that_the_paper_says(report: dict[str, Any]) -> None:
    forms = {name: row["lmi"] for name, row in report["sets"].items()}
    assert forms["none"] == "none"
    assert forms["semi"] == "6×6"
    assert forms["full"] == "4×4"
    assert forms["com_ellipsoid"] == "4×4, 4×4"
    assert forms["ellipsoid"] == "4×4, 1 linear"
    assert forms["points"].endswith(" linear, 4×4")


def test_local_solvers_are_held_against_the_global_optimum(report: dict[str, Any], result: Study) -> None:
    """They know full consistency alone; what they miss of its optimum is said."""
    best = result.sets["full"].certificate.objective
    for name in ("log_cholesky", "manifold"):
        row, certificate = report["estimators"][name], result.estimators[name].certificate
        excess = (certificate.objective - best) / max(certificate.objective, 1.0)
        assert excess > -2 * GAP
        assert row["duality_gap"] == pytest.approx(excess, abs=2 * GAP)
        assert (row["note"] == "") is (row["duality_gap"] <= GAP)
        assert certificate.objective < 1.02 * best
        assert row["rms"]["validation"]["overall"] == pytest.approx(
            report["sets"]["full"]["rms"]["validation"]["overall"], rel=0.02
        )


def test_a_tighter_set_converges_no_later_online(report: dict[str, Any]) -> None:
    """Remark 5."""
    online = report["adaptation"]
    settled = online["time_to_10_percent"]
    assert set(settled) == set(online["error"]) == set(CURVES)
    assert settled["ellipsoid"] is not None
    assert settled["full"] is not None
    assert settled["none"] is None or max(settled["full"], settled["ellipsoid"]) <= settled["none"]
    t = np.array(online["t"])
    assert t[0] == 0
    assert (np.diff(t) > 0).all()
    for name, values in online["error"].items():
        error = np.array(values)
        assert error.shape == t.shape
        assert error[0] == 1
        if settled[name] is not None:
            assert (error[t >= settled[name]] <= 0.1).all()
            assert error[t < settled[name]][-1] > 0.1
    assert online["forgetting"] is None


def test_the_report_is_what_pages_and_people_expect(report: dict[str, Any], leg: Experiment) -> None:
    assert report["joints"] == list(JOINTS)
    assert report["units"] == dict.fromkeys(JOINTS, "N·m")
    assert report["band_hz"] == 40
    assert report["samples"] == {"train": leg.samples(False), "validation": leg.samples(True)}
    assert report["urdf"] == str(LEG)
    assert report["logs"] == [str(TRAIN), str(VALIDATE)]
    assert report["warnings"] == []
    assert report["seconds"] > 0
    assert set(report["estimators"]) == {"euclidean", "pullback", "entropic", "log_cholesky", "manifold"}
    for row in report["sets"].values():
        assert set(row) == {
            *("rms", "seconds", "objective", "duality_gap", "iterations", "lmi", "violations", "worst_margin", "masses")
        }
    for row in report["estimators"].values():
        assert set(row) == {"rms", "seconds", "duality_gap", "iterations", "status", "note"}
    assert all(np.isfinite(x) for x in numbers(report))


def test_the_trace_of_the_held_out_part_has_angles(result: Study) -> None:
    """For Fig. 4: position, and measured and predicted torque."""
    (trace,) = result.validation.traces
    assert {"q", "measured", "residual", "identified"} <= set(trace.curves)
    assert trace.curves["q"].shape == trace.curves["measured"].shape == (3, len(trace.t))


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> pytest.MonkeyPatch:
    """Without local solvers, and the curves of one set."""
    monkeypatch.setattr(module, "LOCAL", {})
    monkeypatch.setattr(module, "CURVES", ("full",))
    monkeypatch.setattr(module, "PRIORS", ("euclidean",))
    monkeypatch.setattr(module, "_REPEATS", 1)
    return monkeypatch


def prepared(tmp_path: Path, **changes: Any) -> Experiment:
    """The leg with another configuration, the first part of one log to fit."""
    data = {**yaml.safe_load(LEG_YAML.read_text()), **changes}
    return prepare(read_robot(LEG), parse_config(data, "leg.yaml"), [TRAIN], holdout=0.5)


def test_sets_that_the_configuration_allows_have_their_rows(tmp_path: Path, quick: pytest.MonkeyPatch) -> None:
    """And none have that it does not."""
    truth = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]["bodies"]
    shapes = {"shank_link": [{"kind": "cylinder", "center": [0, 0, -0.1725], "radius": 0.05, "length": 0.5}]}
    more = prepared(tmp_path, known_com={"thigh_link": truth["thigh_link"]["com"]}, bounding_shapes=shapes)
    rows = study_report(study(more, silent, 1)).to_json()["sets"]
    assert set(rows) == {*ORDER, "points", "known_com", "shape"}
    assert rows["known_com"]["lmi"] == "3×3, 1 linear"
    overall = [row["rms"]["validation"]["overall"] for name, row in rows.items() if name != "points"]
    assert max(overall) < 1.05 * min(overall)
    rotors = {
        name: {key: x for key, x in rotor.items() if key != "bounding_ellipsoid"}
        for name, rotor in yaml.safe_load(LEG_YAML.read_text())["rotors"].items()
    }
    fewer = prepared(tmp_path, bounding_ellipsoids={}, rotors=rotors)
    assert set(study_report(study(fewer, silent, 1)).sets) == {"none", "semi", "full"}


def test_what_is_known_otherwise_holds_in_every_set(tmp_path: Path, quick: pytest.MonkeyPatch) -> None:
    truth = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]["bodies"]
    masses = {"thigh_link": truth["thigh_link"]["mass"]}
    result = study(prepared(tmp_path, known={"mass": masses}), silent, 1)
    for row in study_report(result).to_json()["sets"].values():
        assert row["masses"]["thigh_link"] == pytest.approx(masses["thigh_link"], rel=1e-9)


def test_draws_follow_the_seed(tmp_path: Path, quick: pytest.MonkeyPatch) -> None:
    quick.setattr(module, "_online", lambda *_: module.Online(np.zeros(1), {}, {}))
    curves = [study(prepared(tmp_path, seed=seed), silent, 1).curves["full"].median[:4] for seed in (1, 1, 2)]
    np.testing.assert_array_equal(curves[0], curves[1])
    assert (curves[0] != curves[2]).all()


def test_nothing_held_out_is_refused() -> None:
    experiment = prepare(read_robot(LEG), read_config(LEG_YAML), [TRAIN], holdout=0.0)
    with pytest.raises(ConfigError, match=r"^--holdout: a study compares errors on held-out data; use a larger"):
        study(experiment, silent, 1)


def test_the_estimates_come_near_the_truth_in_what_is_determined(result: Study) -> None:
    """Every set's torque against that of the bodies and friction with which the log was made, by the R-factors."""
    truth = yaml.safe_load((SAMPLES / "truth.yaml").read_text())["leg"]
    bodies = {
        name: from_mass_com_inertia(body["mass"], body["com"], symmetric_matrix(body["inertia"]))
        for name, body in truth["bodies"].items()
    }
    theta = np.array(
        [
            bodies[c.owner][PARAMETER_NAMES.index(c.name)] if c.owner in bodies else truth["friction"][c.owner][c.name]
            for c in result.experiment.equation.coefficients
        ]
    )
    reduction = result.experiment.reduce(silent)
    for outcome in result.sets.values():
        for factor, columns in zip(reduction, result.experiment.equation.active(), strict=True):
            off = factor.R[:, :-1] @ (outcome.theta - theta)[columns] / np.sqrt(factor.rows)
            assert np.linalg.norm(off) < 0.05


@pytest.mark.slow
def test_the_papers_order_with_the_default_draws(leg: Experiment) -> None:
    """Its spread over the draws is small enough to tell the four curves apart."""
    result = study(leg, silent)
    assert result.draws >= 30
    report = study_report(result).to_json()
    medians = at(report, 30)
    assert medians["ellipsoid"] <= medians["full"] <= medians["semi"] * 1.01
    assert medians["semi"] <= 1.01 * medians["none"]
