"""Gap that `idtool diagnose` closes where an effect is hidden, compared with what the true effect would close.

Run ``python benchmarks/true_model.py CASES DIAGNOSES``, with the folders that ``scoreboard.py --cache CASES --keep
DIAGNOSES`` wrote. For each single backlash and joint elasticity, the model with the true effect, its parameters as
simulated, is fitted to the same log. Columns: the held-out RMS torque error of all joints without the effect, with the
one found and with the true one, and the part of what the true one closes that the one found closes.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml

EFFECTS = {"backlash": ("width", "motor_friction"), "joint_elasticity": ("stiffness", "motor_friction")}


def error_of_true_model(case: Path, hidden: dict[str, Any]) -> float:
    """Held-out RMS torque error of the model with the true effect [N m].

    Parameters
    ----------
    case
        Folder of the case.
    hidden
        Its hidden effect.
    """
    names = EFFECTS[hidden["effect"]]
    parameters = {name: hidden["parameters"][name] for name in names if hidden["parameters"].get(name)}
    config = yaml.safe_load((case / "config.yaml").read_text())
    config["effects"] = [{"effect": hidden["effect"], "joint": hidden["joint"], "parameters": parameters}]
    with tempfile.TemporaryDirectory() as folder:
        config_file = Path(folder) / "config.yaml"
        config_file.write_text(yaml.safe_dump(config))
        arguments = [case / "robot.urdf", case / "log.csv", "--config", config_file, "--quick", "--out", folder]
        command = [sys.executable, "-m", "idtool", "fit", *map(str, arguments)]
        subprocess.run(command, check=True, capture_output=True)
        report = json.loads((Path(folder) / "report.json").read_text())
    return float(report["rms"]["validation"]["overall"])


def main() -> None:
    """Print a line for each case and the least part that is closed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", type=Path)
    parser.add_argument("diagnoses", type=Path)
    options = parser.parse_args()

    parts = []
    print("N m: without, found, true; part of the gap")
    for truth_file in sorted(options.cases.glob("*/truth.json")):
        case = truth_file.parent
        truth = json.loads(truth_file.read_text())
        found_file = options.diagnoses / truth["case"] / "diagnosis.json"
        hidden = truth["hidden"]
        if len(hidden) != 1 or hidden[0]["effect"] not in EFFECTS or not found_file.exists():
            continue
        diagnosis = json.loads(found_file.read_text())
        without, found = (diagnosis[when]["validation"]["overall"] for when in ("before", "after"))
        true = error_of_true_model(case, hidden[0])
        parts.append((without - found) / (without - true))
        print(f"{truth['case']:45}  {without:.4g}  {found:.4g}  {true:.4g}  {parts[-1]:.2f}", flush=True)
    print(f"least of {len(parts)}: {min(parts):.2f}" if parts else "no such case")


if __name__ == "__main__":
    main()
