"""Words of the command line that make no sense, and places that cannot be written to. Files: test_bad_*.py."""

from __future__ import annotations

from pathlib import Path

import pytest
from commands import LEG, SAMPLES, TRAIN, csv_text, idtool, refuse, sample_table

FIT, VALIDATION = ["fit", LEG, "log.csv", "--out", "out"], ["validate", LEG, "log.csv", "--out", "out"]

TWO = (
    "error: --decide: needs two explanations, EFFECT:JOINT each or a configuration with effects; for example "
    "--decide backlash:hip payload:shank\n"
)

WORDS: dict[str, tuple[list[object], str]] = {
    "unknown command": (["fitt", LEG, "log.csv"], "fitt"),
    "unknown option": ([*FIT, "--hold", "0.3"], "--hold"),
    "unknown option before a command": (["--quite", *FIT], "--quite"),
    "option without its value": (["fit", LEG, "log.csv", "--out"], "--out"),
    "fit without arguments": (["fit"], "missing argument 'URDF'"),
    "fit without a log": (["fit", LEG, "--out", "out"], "missing argument 'LOG'"),
    "validate without a log": (["validate", LEG, "--out", "out"], "logs"),
    "one explanation at the end": (["excite", LEG, "--decide", "parallel_spring:hip"], TWO),
    "one explanation before the URDF": (["excite", "--decide", "parallel_spring:hip", LEG], TWO),
    "one explanation before an option": (["excite", LEG, "--decide", "parallel_spring:hip", "--duration", "5"], TWO),
    "no explanation": (["excite", LEG, "--decide"], TWO),
    "inspect without a log": (["inspect"], "missing argument 'LOG'"),
    "inspect with two logs": (["inspect", TRAIN, TRAIN], "argument"),
    "regression with options": (["validate", "--max-rms", "0.1"], "urdf"),
    "holdout above 1": ([*FIT, "--holdout", "1.5"], "--holdout: 1.5"),
    "holdout of 1": ([*FIT, "--holdout", "1"], "--holdout: 1"),
    "holdout below 0": ([*FIT, "--holdout", "-0.1"], "--holdout: -0.1"),
    "holdout that is not a number": ([*FIT, "--holdout", "some"], "--holdout"),
    "holdout of nan": ([*FIT, "--holdout", "nan"], "--holdout: nan"),
    "nearly all held out": ([*FIT, "--holdout", "0.999"], "log.csv: "),
    "max-rms that is not a number": ([*FIT, "--max-rms", "small"], "--max-rms: small"),
    "max-rms without a number": ([*FIT, "--max-rms", "hip="], "--max-rms: hip="),
    "max-rms of an unknown joint": ([*FIT, "--max-rms", "hipp=1"], "--max-rms: hipp is not a joint; did you mean hip?"),
    "max-rms of nan": ([*VALIDATION, "--max-rms", "nan"], "--max-rms: nan"),
    "max-rms of infinity": ([*VALIDATION, "--max-rms", "hip=inf"], "--max-rms: hip=inf"),
    "max-rms below 0": ([*VALIDATION, "--max-rms", "-1"], "--max-rms: -1"),
    "max-rms that is empty": ([*VALIDATION, "--max-rms", ""], "--max-rms: "),
    "a log in place of the URDF": (["fit", "log.csv", "log.csv"], "log.csv: is a log; give the URDF first"),
    "the URDF in place of a log": (["fit", LEG, LEG, "--out", "out"], "leg.urdf: is not a log"),
    "a config that is not there": ([*FIT, "--config", "none.yaml"], "none.yaml: cannot be read"),
    "a prior that is not there": ([*VALIDATION, "--prior", "none.urdf"], "none.urdf: cannot be read"),
    "a prior of another robot": ([*VALIDATION, "--prior", SAMPLES / "belt_arm.urdf"], "abad"),
    "a log of another robot": (
        ["validate", SAMPLES / "belt_arm.urdf", "log.csv"],
        "joints: waist: is not in every log",
    ),
    "a validation log that is not there": ([*FIT, "--validate", "none.csv"], "none.csv: there is no such file"),
    "one log of two is not there": ([*FIT, "none.csv"], "none.csv: there is no such file"),
    "a path of no name": (["fit", "", "log.csv"], "is a folder; give a URDF"),
    "a path that ends in the middle": (["fit", "a\0b", "log.csv"], "URDF"),
    "a path of two lines": (["fit", "a\nb.urdf", "log.csv"], r"a\nb.urdf: cannot be read"),
    "a path that is no text": (["fit", "a\udcff.urdf", "log.csv"], r"a\udcff.urdf: cannot be read"),
    "a path without end": (["fit", "a" * 5000, "log.csv"], "cannot be read"),
    "a folder in place of a config": ([*FIT, "--config", "."], "cannot be read"),
}


@pytest.fixture(autouse=True)
def log(tmp_path: Path) -> None:
    """A short log of the leg."""
    (tmp_path / "log.csv").write_text(csv_text(sample_table(1200)))


def test_the_log_itself_can_be_used(tmp_path: Path) -> None:
    assert idtool(*FIT, folder=tmp_path).code == 0


@pytest.mark.parametrize(("arguments", "naming"), WORDS.values(), ids=WORDS)
def test_words(tmp_path: Path, arguments: list[object], naming: str) -> None:
    refuse(tmp_path, *arguments, naming=naming)


@pytest.mark.parametrize("command", ["fit", "validate"])
@pytest.mark.parametrize(
    ("place", "naming"),
    [
        ("log.csv", "log.csv: is a file, but a folder is needed"),
        ("log.csv/below", "log.csv: is a file, but a folder is needed"),
        ("/dev/null/idtool", "/dev/null: is a file, but a folder is needed"),
        ("/proc/idtool", "/proc/idtool: cannot be written to"),
    ],
)
def test_places_that_cannot_be_written_to(tmp_path: Path, command: str, place: str, naming: str) -> None:
    refuse(tmp_path, command, LEG, "log.csv", "--out", place, naming=naming)


@pytest.mark.parametrize(("command", "last"), [("fit", "report.html"), ("validate", "validation.html")])
def test_a_folder_in_an_outputs_place(tmp_path: Path, command: str, last: str) -> None:
    """The other files must not be replaced before it shows that the last cannot be."""
    (tmp_path / "results" / last).mkdir(parents=True)
    for name in ("identified.urdf", "model.yaml", "report.json", "validation.json"):
        (tmp_path / "results" / name).write_text("former")
    refuse(tmp_path, command, LEG, "log.csv", "--out", "results", naming=f"results/{last}: is a folder")


def test_a_write_that_fails_half_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A full disk: what was written so far goes, what was there stays."""
    write, written = Path.write_bytes, []

    def fail(path: Path, data: bytes) -> int:
        if path.name == "report.json":
            write(path, data[:100])
            raise OSError(28, "No space left on device")
        written.append(path.name)
        return write(path, data)

    monkeypatch.setattr(Path, "write_bytes", fail)
    refuse(tmp_path, *FIT, naming="out: cannot be written to (No space left on device)")
    assert written


MANIFESTS = {
    "empty": ("", "has no cases"),
    "a list": ("[1]", "has no cases"),
    "no cases": ("cases: []", "has no cases"),
    "not YAML": ("cases: [", "is not YAML"),
    "a case that is a word": ("cases: [leg]", "case 1: "),
    "a case without a URDF": ("cases: [{name: a}]", "urdf"),
    "an unknown key": ("cases: [{name: a, urd: b}]", "unknown key 'urd'; did you mean 'urdf'?"),
    "no bound": ("cases: [{name: a, urdf: b, fit: [c], validation: [d], max_rms: {}}]", "max_rms"),
    "a bound of 0": ("cases: [{name: a, urdf: b, fit: [c], validation: [d], max_rms: {hip: 0}}]", "max_rms.hip"),
    "a URDF that is not there": (
        "cases: [{name: a, urdf: b.urdf, fit: [c], validation: [d], max_rms: {overall: 1}}]",
        "b.urdf: cannot be read",
    ),
    "a bound on an unknown joint": (
        f"cases: [{{name: a, urdf: {LEG}, config: {LEG.with_suffix('.yaml')}, fit: [../log.csv], "
        "validation: [../log.csv], max_rms: {hipp: 1}}]",
        "hipp",
    ),
}


@pytest.mark.parametrize(("text", "naming"), MANIFESTS.values(), ids=MANIFESTS)
def test_manifests(tmp_path: Path, text: str, naming: str) -> None:
    (tmp_path / "sample_logs").mkdir()
    (tmp_path / "sample_logs" / "manifest.yaml").write_text(text)
    refuse(tmp_path, "validate", naming=naming)
