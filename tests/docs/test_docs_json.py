"""The page of JSON files names every key that is written or printed, and no others."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml
from commands import JOINTS, csv_text, idtool, sample_table
from doc_pages import PAGES, Reader
from doc_tables import misfits, section

from idtool.cli import app


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Reader:
    """A folder with a robot and logs."""
    return Reader(tmp_path_factory.mktemp("reports"), slow=True)


def report(reader: Reader, *command: str) -> dict[str, Any]:
    """What a command prints as JSON."""
    done = idtool(*command, "--json", "--quiet", folder=reader.folder)
    assert done.code == 0, done.err
    return done.json


def config_with(folder: Path, name: str, **changes: Any) -> str:
    """The leg's configuration with some keys changed."""
    data = yaml.safe_load((folder / "leg.yaml").read_text()) | changes
    (folder / name).write_text(yaml.safe_dump(data))
    return name


def commanded(folder: Path, name: str, stiffness: float) -> str:
    """The first seconds of the sample log with the command that its torque answers to, in the torque's place."""
    header, *rows = sample_table(4000)
    places = [(header.index(f"q_{joint}"), header.index(f"tau_{joint}")) for joint in JOINTS]
    for row in rows:
        for q, tau in places:
            row[tau] = repr(float(row[q]) + float(row[tau]) / stiffness)
    renamed = [title.replace("tau_", "qcmd_") for title in header]
    (folder / name).write_text(csv_text([renamed, *rows]))
    return name


AS_IN_REPORT = ("friction", "friction_intervals", "rotors", "bodies", "known", "solver")  # of diagnosis.json


def check_keys(heading: str, *reports: dict[str, Any], whole: Sequence[str] = (), part: int | None = None) -> None:
    """That a section, or one of its tables, names every key of these reports and no others.

    ``whole`` are keys named with all they hold.
    """
    names = {"joint": {joint for one in reports for joint in (*one.get("joints", JOINTS), "overall")}}
    names["fit"] = {"chosen", "weaker", "stronger"}
    if isinstance(reports[0].get("bodies"), dict):
        bodies = {body for one in reports for body in one["bodies"]}
        names |= {"body": bodies, "rotor": bodies}
    text = section("json.md", f"## {heading}")
    if part is not None:
        text = re.split(r"^\| key .*$", text, flags=re.M)[1:][part]
    assert misfits(text, reports, names, whole) == []


def test_every_key_of_report_json_is_documented(reader: Reader) -> None:
    union = {"shank_link": [{"center": [0, 0, -z], "semi_axes": [0.05, 0.05, 0.2]} for z in (0.1, 0.25)]}
    known = config_with(
        reader.folder, "known.yaml", known={"total_mass": 3.8}, constraints="none", bounding_ellipsoids={}
    )
    parts = config_with(reader.folder, "parts.yaml", bounding_ellipsoids=union)
    late = config_with(reader.folder, "late.yaml", controller={"kp": dict.fromkeys(JOINTS, 300.0)})
    check_keys(
        "report.json",
        report(reader, "fit", "leg.urdf", "run1.mcap", "run2.mcap"),
        report(reader, "fit", "leg.urdf", "run1.mcap", "--quick", "--config", known),
        report(reader, "fit", "leg.urdf", "run1.mcap", "--quick", "--config", parts),
        report(reader, "fit", "leg.urdf", commanded(reader.folder, "late.csv", 300.0), "--config", late),
    )


def test_every_key_of_validation_json_is_documented(reader: Reader) -> None:
    options = ("--prior", "robot.urdf", "--max-rms", "9", "--max-rms", "hip=9")
    check_keys("validation.json", report(reader, "validate", "leg.urdf", "run3.mcap", *options))


def test_every_key_of_adapt_json_is_documented(reader: Reader) -> None:
    check_keys("adapt.json", report(reader, "adapt", "leg.urdf", "run1.mcap"))


@pytest.mark.slow
def test_every_key_of_study_json_is_documented(reader: Reader) -> None:
    check_keys("study.json", report(reader, "study", "leg.urdf", "run1.mcap", "--draws", "5"))


@pytest.mark.slow
def test_every_key_of_diagnosis_json_is_documented(reader: Reader) -> None:
    less = config_with(reader.folder, "less.yaml", friction={"knee": {"coulomb": False}})
    effects = "coulomb_friction,presliding_hysteresis,torque_offset"
    found = report(reader, "diagnose", "leg.urdf", "sample_logs/leg_train.mcap", "--config", less, "--effects", effects)
    assert found["steps"]
    check_keys("diagnosis.json", found, whole=AS_IN_REPORT)


def test_every_command_has_a_section() -> None:
    headings = set(re.findall(r"^## (.*)$", (PAGES / "json.md").read_text(), re.M))
    files = {"fit": "report.json", "validate": "validation.json", "diagnose": "diagnosis.json"}
    files |= {name: f"{name}.json" for name in ("study", "adapt")}
    commands = typer.main.get_command(app).commands  # type: ignore[attr-defined]
    assert headings == {files.get(name, name) for name in commands} | {"The regression"}


def gappy(reader: Reader) -> str:
    """A log with a gap and without a velocity, whose torque says nothing on one joint."""
    with (reader.folder / "sample_logs" / "leg_validate.csv").open() as log:
        head, *rows = [line.rstrip().split(",") for line in log]
    drop = head.index("v_knee")
    kept = [head, *rows[:1500], *rows[1900:4000]]
    lines = [",".join(x for i, x in enumerate(row) if i != drop) for row in kept]
    (reader.folder / "gappy.csv").write_text("\n".join(lines))
    return "gappy.csv"


def test_every_key_of_inspect_is_documented(reader: Reader) -> None:
    reports = [report(reader, "inspect", log) for log in ("run1.mcap", gappy(reader))]
    assert reports[1]["stamps"]["longest_gaps"]
    assert reports[0]["findings"]
    check_keys("inspect", *reports)


def test_every_key_of_init_is_documented(reader: Reader) -> None:
    found = report(reader, "init", "leg.urdf", "run1.mcap", "--out", "first.yaml")
    assert found["trials"]
    assert found["left"]
    check_keys("init", found, whole=["config"])


def test_every_key_of_simulate_is_documented(reader: Reader) -> None:
    check_keys("simulate", report(reader, "simulate", "leg.urdf", "run3.mcap", "--out", "simulated.csv"))


def test_every_key_of_excite_is_documented(reader: Reader) -> None:
    short = ("--duration", "4", "--iterations", "1", "--rate", "200", "--out", "short.csv")
    found = report(reader, "excite", "leg.urdf", "--log", "run1.mcap", "--favour", "hip", *short)
    assert "logged" in found["criteria"]
    check_keys("excite", found)


def test_every_key_of_export_is_documented(reader: Reader) -> None:
    report(reader, "fit", "leg.urdf", "run1.mcap", "--quick", "--out", "exported")
    check_keys("export", *(report(reader, "export", "exported", "--to", to) for to in ("mujoco", "drake")))


def test_every_key_of_ellipsoids_is_documented(reader: Reader) -> None:
    wrong = (reader.folder / "leg.urdf").read_text().replace('<mass value="1.5"/>', '<mass value="-1.5"/>')
    (reader.folder / "wrong.urdf").write_text(wrong)
    checked = report(reader, "ellipsoids", "wrong.urdf", "--check", "--repair", "repaired.urdf")
    assert checked["links"]["abad_link"]["violations"]
    check_keys("ellipsoids", report(reader, "ellipsoids", "leg.urdf"), part=0)
    check_keys("ellipsoids", checked, part=1)


@pytest.mark.slow
def test_every_key_of_the_regression_is_documented(reader: Reader) -> None:
    check_keys("The regression", report(reader, "validate"))
