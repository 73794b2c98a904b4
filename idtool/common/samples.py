"""The sample robots and logs that come with idtool, in the installed package or in the checkout that it runs from."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Literal, get_args

from idtool.common.dataclass import dataclass
from idtool.common.exceptions import ConfigError

FOLDER = "sample_logs"
MANIFEST = "manifest.yaml"

SampleName = Literal["leg", "belt_arm", "quadruped", "hidden", "pair"]


@dataclass(frozen=True)
class Sample:
    """A sample: robots, their logs, and how to begin with them.

    Attributes
    ----------
    patterns
        Patterns of the paths of its files in the folder of all samples.
    first_command
        A first command for it; ``{}`` stands for the folder.
    """

    patterns: tuple[str, ...]
    first_command: str

    def files(self) -> dict[str, bytes]:
        """The content of its files by their path in the folder.

        Raises
        ------
        ConfigError
            If idtool was installed without its samples.
        """
        folder = sample_folder()
        found: list[Path] = []
        for pattern in self.patterns:
            found += folder.glob(pattern)
        content = {}
        for path in sorted(found):
            if path.is_file():  # in a checkout, folders of results may be beside the files
                content[path.relative_to(folder).as_posix()] = path.read_bytes()
        return content

    def command(self, folder: Path) -> str:
        """The first command, for files in a folder."""
        words = self.first_command.split()
        return shlex.join(word.replace("{}", str(folder)) for word in words)


_SAMPLES: dict[SampleName, Sample] = {
    "leg": Sample(
        ("leg.urdf", "leg.yaml", "leg_*", "truth.yaml"),
        "idtool fit {}/leg.urdf {}/leg_train.mcap --validate {}/leg_validate.mcap",
    ),
    "belt_arm": Sample(
        ("belt_arm.urdf", "belt_arm.yaml", "belt_arm_*", "truth.yaml"),
        "idtool fit {}/belt_arm.urdf {}/belt_arm_train.mcap --validate {}/belt_arm_validate.mcap",
    ),
    "hidden": Sample(
        ("hidden/*/*",),
        "idtool diagnose {}/hidden/spring/robot.urdf {}/hidden/spring/log.csv --config {}/hidden/spring/config.yaml",
    ),
    "pair": Sample(
        ("pair/*.*", "pair/*/*"),
        "idtool diagnose {}/pair/arm.urdf {}/pair/robot/run1.csv --against {}/pair/simulator",
    ),
    "quadruped": Sample(
        ("quadruped/quadruped.*", "quadruped/true.urdf", "quadruped/*.csv"),
        "idtool fit {}/quadruped/quadruped.urdf {}/quadruped/stand.csv {}/quadruped/walk.csv "
        "{}/quadruped/hang.csv --quick",
    ),
}


def find_sample(name: str) -> Sample:
    """The sample of a name.

    Raises
    ------
    ConfigError
        If there is none.
    """
    for known, sample in _SAMPLES.items():
        if known == name:
            return sample
    raise ConfigError(name, f"is not a sample; choose {', '.join(get_args(SampleName))}")


def sample_folder() -> Path:
    """The folder of all samples, in the package or in the checkout.

    Raises
    ------
    ConfigError
        If it is in neither.
    """
    package = Path(__file__).parents[1]
    for parent in (package, package.parent):
        folder = parent / FOLDER
        if (folder / MANIFEST).is_file():
            return folder
    raise ConfigError(FOLDER, "is not in the installed package; install idtool again, from its wheel")
