"""Regression test: every case of a manifest is fitted and compared with its recorded bounds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import Field

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError
from idtool.common.safe_yaml import read_yaml
from idtool.common.samples import FOLDER, MANIFEST, sample_folder
from idtool.estimation.dataset.experiment import Progress, prepare
from idtool.estimation.fit import fit
from idtool.robot.config import Config, ConfigRecord, Positive, read_config, validate_record
from idtool.robot.urdf.reading import read_robot


class Case(ConfigRecord):
    """A robot, its logs, and the largest rms in the band [N·m or N] on the validation logs, by joint or ``overall``."""

    name: str
    urdf: str
    config: str | None = None
    fit: Annotated[tuple[str, ...], Field(min_length=1)]
    validation: Annotated[tuple[str, ...], Field(min_length=1)]
    max_rms: Annotated[dict[str, Positive], Field(min_length=1)]


@dataclass(frozen=True)
class Outcome:
    """One figure of one case: rms in the band, its bound, the prior's, all [N·m or N]."""

    case: str
    joint: str
    rms: float
    bound: float
    prior: float

    @property
    def ok(self) -> bool:
        """True if the bound was met."""
        return self.rms <= self.bound


def find_manifest() -> Path:
    """The manifest of the working directory, else that of the samples that come with idtool.

    Raises
    ------
    ConfigError
        If there is neither.
    """
    path = Path(FOLDER, MANIFEST)
    return path if path.exists() else sample_folder() / MANIFEST


def read_manifest(path: Path) -> tuple[Case, ...]:
    """The cases of a manifest.

    Raises
    ------
    ConfigError
        If it cannot be read or a case lacks something.
    """
    data = read_yaml(path)
    cases = data.get("cases") if isinstance(data, dict) else None
    if not isinstance(cases, list) or not cases:
        raise ConfigError(path, "has no cases; list them under cases")
    return tuple(validate_record(Case, case, f"{path}: case {number}") for number, case in enumerate(cases, start=1))


def run_case(case: Case, folder: Path, progress: Progress) -> list[Outcome]:
    """Fit one case and compare with its bounds.

    Raises
    ------
    IdtoolError
        If a file cannot be used.
    """
    config = read_config(folder / case.config) if case.config else Config()
    experiment = prepare(
        read_robot(folder / case.urdf),
        config,
        [folder / name for name in case.fit],
        [folder / name for name in case.validation],
    )
    result = fit(experiment, progress)
    joints = experiment.equation.joints
    rms = result.validation.errors["identified"].rms(joints)
    prior = result.validation.errors["prior"].rms(joints)
    unknown = set(case.max_rms) - set(rms)
    if unknown:
        raise ConfigError(
            f"max_rms of case {case.name}", f"names joints that the model does not have: {', '.join(sorted(unknown))}"
        )
    return [Outcome(case.name, name, rms[name], bound, prior[name]) for name, bound in case.max_rms.items()]
