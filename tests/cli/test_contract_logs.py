"""Logs as users have them: formats, column names and order, joints that are missing or strange, gaps, commands."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import (
    JOINTS,
    LEG,
    TRAIN,
    VALIDATE,
    VALIDATE_CSV,
    Row,
    column_set,
    columns_kept,
    config_with,
    csv_text,
    fitted,
    numbers,
    sample_table,
    validated,
)
from numpy.typing import NDArray
from recordings import Proto, State, proto_channel, write_mcap

from idtool.data.logs import read_log

Column = NDArray[np.float64]

LEG_YAML = LEG.with_suffix(".yaml")
ROWS = 6000


def sentences_of(report: dict[str, Any]) -> list[str]:
    """The messages of a report's notices."""
    return [notice["message"] for notice in report["notices"]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with an identified leg in it."""
    folder = tmp_path_factory.mktemp("identified")
    fitted(folder, LEG, TRAIN)
    return folder


@pytest.fixture(scope="module")
def table() -> list[Row]:
    """Six seconds of the CSV sample log."""
    return sample_table(ROWS)


@pytest.fixture(scope="module")
def expected(folder: Path, table: list[Row]) -> dict[str, float]:
    """Errors of the identified leg on the table."""
    return errors(folder, table)


def errors(folder: Path, table: list[Row], **changes: Any) -> dict[str, float]:
    """Errors of the identified leg on a table, the configuration changed."""
    path = folder / "log.csv"
    path.write_text(csv_text(table))
    config = config_with(folder / "changed.yaml", folder / "model.yaml", **changes)
    report = validated(folder / "out", folder / "identified.urdf", path, "--config", config)
    return dict(report["rms"]["model"])


def renamed(table: list[Row], names: dict[str, str]) -> list[Row]:
    """The table with other column names."""
    return [[names.get(name, name) for name in table[0]], *table[1:]]


def column(table: list[Row], name: str) -> Column:
    """A column's numbers."""
    place = table[0].index(name)
    return np.array([float(row[place]) for row in table[1:]])


def joined(table: list[Row], **columns: Column) -> list[Row]:
    """The table with more columns at its end."""
    more = zip(*(map(repr, values.tolist()) for values in columns.values()), strict=True)
    return [[*table[0], *columns], *([*row, *cells] for row, cells in zip(table[1:], more, strict=True))]


def test_csv_and_mcap_give_the_same_figures(tmp_path: Path, folder: Path) -> None:
    model = folder / "identified.urdf"
    one, two = (validated(tmp_path, model, log) for log in (VALIDATE, VALIDATE_CSV))
    for key in ("rms", "rms_raw", "nrms"):
        assert list(numbers(one[key])) == pytest.approx(list(numbers(two[key])), rel=1e-6)
    assert one["samples"] == two["samples"]


def test_protobuf_gives_the_same_figures(tmp_path: Path, folder: Path) -> None:
    log = read_log(VALIDATE_CSV)
    q, v, tau = (log.signals[name].tolist() for name in ("q", "v", "tau"))
    stamps = np.rint(log.t * 1e9).astype(np.int64).tolist()
    items = [State(stamp, log.joints, *three) for stamp, *three in zip(stamps, q, v, tau, strict=True)]
    path = write_mcap(tmp_path / "proto.mcap", proto_channel(items, Proto()))
    model = folder / "identified.urdf"
    one, two = (validated(tmp_path, model, log)["rms"]["model"] for log in (path, VALIDATE_CSV))
    assert one == pytest.approx(two, rel=1e-6)


def test_columns_in_any_order(folder: Path, table: list[Row], expected: dict[str, float]) -> None:
    order = np.random.default_rng(0).permutation(len(table[0]))
    assert errors(folder, [[row[i] for i in order] for row in table]) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("prefix", ["", "/joint_states/", "/robot/arm/"])
@pytest.mark.parametrize("mark", [".", "/"])
@pytest.mark.parametrize("time", ["time", "__time", "timestamp"])
def test_plotjuggler_names(
    folder: Path, table: list[Row], expected: dict[str, float], prefix: str, mark: str, time: str
) -> None:
    fields = {"q": "position", "v": "velocity", "tau": "effort"}
    names = {f"{s}_{j}": f"{prefix}{j}{mark}{field}" for s, field in fields.items() for j in JOINTS}
    assert errors(folder, renamed(table, {**names, "t": time})) == pytest.approx(expected, rel=1e-12)


def test_columns_named_in_the_config(folder: Path, table: list[Row], expected: dict[str, float]) -> None:
    strange = renamed(table, {"t": "clock", "tau_hip": "hip torque"})
    changes = {"log": {"columns": {"t": "clock", "tau_hip": "hip torque"}}}
    assert errors(folder, strange, **changes) == pytest.approx(expected, rel=1e-12)


def test_scale_takes_a_log_to_si(folder: Path, table: list[Row], expected: dict[str, float]) -> None:
    current = column(table, "tau_hip") / 0.118
    in_amperes = joined(columns_kept(table, lambda name: name != "tau_hip"), tau_hip=current)
    assert errors(folder, in_amperes)["hip"] > 10 * expected["hip"]
    changes = {"log": {"scale": {"tau": {"hip": 0.118}}}}
    assert errors(folder, in_amperes, **changes) == pytest.approx(expected, rel=1e-9)


def test_torque_from_a_position_controller(folder: Path, table: list[Row], expected: dict[str, float]) -> None:
    kp, kd = 20.0, 1.5
    extra: dict[str, Column] = {}
    for joint in JOINTS:
        q, v, tau = (column(table, f"{signal}_{joint}") for signal in ("q", "v", "tau"))
        vcmd = 0.5 * v
        extra |= {f"vcmd_{joint}": vcmd, f"qcmd_{joint}": q + (tau - kd * (vcmd - v)) / kp}
    commanded = joined(columns_kept(table, lambda name: not name.startswith("tau")), **extra)
    controller = {"kp": dict.fromkeys(JOINTS, kp), "kd": dict.fromkeys(JOINTS, kd)}
    assert errors(folder, commanded, controller=controller) == pytest.approx(expected, rel=1e-6)


def test_a_logged_torque_goes_before_the_controllers(
    folder: Path, table: list[Row], expected: dict[str, float]
) -> None:
    commanded = joined(table, qcmd_hip=column(table, "q_hip") + 1)
    assert errors(folder, commanded, controller={"kp": {"hip": 20.0}}) == pytest.approx(expected, rel=1e-12)


def test_a_strange_joint_is_named_and_ignored(
    tmp_path: Path, folder: Path, table: list[Row], expected: dict[str, float]
) -> None:
    q = column(table, "q_hip")
    strange = joined(table, q_tail=q, v_tail=q, tau_tail=q)
    assert errors(folder, strange) == pytest.approx(expected, rel=1e-12)
    (tmp_path / "log.csv").write_text(csv_text(strange))
    report = fitted(tmp_path / "out", LEG, tmp_path / "log.csv")
    assert report["joints"] == list(JOINTS)
    assert any("tail" in warning and "ignored" in warning for warning in report["warnings"])


def test_a_joint_that_is_not_in_the_log_is_locked(tmp_path: Path, table: list[Row]) -> None:
    shutil.copy(LEG, tmp_path)
    (tmp_path / "log.csv").write_text(csv_text(columns_kept(table, lambda name: "abad" not in name)))
    reports = []
    for locked in (None, {"abad": 0.3}):
        config_with(tmp_path / "leg.yaml", LEG_YAML, joints=None, locked_joints=locked)
        reports.append(fitted(tmp_path / "out", tmp_path / "leg.urdf", tmp_path / "log.csv"))
        assert reports[-1]["joints"] == ["hip", "knee"]
        assert set(reports[-1]["bodies"]) == {"thigh_link", "shank_link", "hip_rotor", "knee_rotor"}
    for report, place in zip(reports, ("0", "0.3"), strict=True):
        assert f"joints assumed to stand still: abad at {place}" in [notice["message"] for notice in report["notices"]]
    prior = [report["rms"]["prior_validation"]["hip"] for report in reports]
    assert prior[0] != pytest.approx(prior[1], rel=1e-3)  # gravity pulls another way


def test_a_joint_that_is_left_out_although_it_moves_is_said(tmp_path: Path, table: list[Row]) -> None:
    shutil.copy(LEG, tmp_path)
    config_with(tmp_path / "leg.yaml", LEG_YAML, joints=["hip", "knee"], locked_joints={"abad": 0.1})
    travel = np.ptp(np.percentile(column(table, "q_abad"), (0.5, 99.5)))
    assert travel > 0.3
    shaking = 0.1 + 0.009 * np.sign(np.sin(np.arange(ROWS)))
    shaking[ROWS // 2] = 3.0  # a reading that is none
    said = []
    for rows in (table, column_set(table, "q_abad", lambda i: shaking[i])):
        (tmp_path / "log.csv").write_text(csv_text(rows))
        warnings = fitted(tmp_path / "out", tmp_path / "leg.urdf", tmp_path / "log.csv")["warnings"]
        said.append([warning for warning in warnings if warning.startswith("these joints are assumed to stand")])
    ((moving,), still) = said
    assert moving.startswith(
        "these joints are assumed to stand still, but move in the log: "
        f"abad (moves by {travel:.3g} rad, assumed position 0.1); "
    )
    assert moving.endswith("biases the parameters; add them to joints, or keep them at rest while you log")
    assert still == []


def test_a_missing_velocity_is_differentiated_and_said(tmp_path: Path, folder: Path, table: list[Row]) -> None:
    lacking = columns_kept(table, lambda name: name != "v_hip")
    whole, without = (errors(folder, rows, velocity="differentiated") for rows in (table, lacking))
    assert without == pytest.approx(whole, rel=1e-12)
    (tmp_path / "log.csv").write_text(csv_text(lacking))
    report = fitted(tmp_path / "out", LEG, tmp_path / "log.csv")
    messages = [notice["message"] for notice in report["notices"]]
    assert "no velocity was logged; it is differentiated from q: hip" in messages


def test_no_filter_crosses_a_gap(tmp_path: Path, folder: Path) -> None:
    """Two runs of different motion in one file, some time apart: the errors are those of the two files."""
    table = sample_table(9000)
    parts = [table[1:4001], table[6001:9001]]
    paths = [tmp_path / name for name in ("first.csv", "second.csv")]
    for path, part in zip(paths, parts, strict=True):
        path.write_text(csv_text([table[0], *part]))
    (tmp_path / "both.csv").write_text(csv_text([table[0], *parts[0], *parts[1]]))
    model = folder / "identified.urdf"
    apart, both = validated(tmp_path, model, *paths), validated(tmp_path, model, tmp_path / "both.csv")
    assert both["samples"] == apart["samples"]
    assert both["rms"]["model"] == pytest.approx(apart["rms"]["model"], rel=5e-3)


def test_samples_without_a_value_are_left_out_and_counted(tmp_path: Path, table: list[Row]) -> None:
    place = table[0].index("tau_knee")
    for i, value in {2000: "nan", 2001: "-inf", 4000: "inf"}.items():
        table = [*table[:i], [*table[i][:place], value, *table[i][place + 1 :]], *table[i + 1 :]]
    (tmp_path / "log.csv").write_text(csv_text(table))
    report = fitted(tmp_path / "out", LEG, tmp_path / "log.csv")
    assert any(warning.startswith("3 samples have values that are not finite") for warning in report["warnings"])


def test_a_log_that_was_cut_off_is_used_as_far_as_it_goes(tmp_path: Path) -> None:
    data = TRAIN.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    report = fitted(tmp_path / "out", LEG, tmp_path / "cut.mcap")
    (warning,) = (warning for warning in report["warnings"] if "cut off" in warning)
    kept = int(warning.split("kept: ")[1].split()[0])
    assert 2000 < kept < 8000
    assert sum(numbers(report["samples"])) == pytest.approx(kept, rel=0.06)


def test_several_logs_are_fitted_together(tmp_path: Path) -> None:
    one, two = (fitted(tmp_path, LEG, *logs, "--holdout", "0") for logs in ((TRAIN,), (TRAIN, VALIDATE)))
    ratio = np.sqrt(sum(numbers(one["samples"])) / sum(numbers(two["samples"])))
    for joint in JOINTS:
        errors = [report["friction"][joint]["standard_error"]["coulomb"] for report in (one, two)]
        assert errors[1] / errors[0] == pytest.approx(ratio, rel=0.15)
