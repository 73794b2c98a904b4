"""The command line itself: help, examples, where things are printed, exit codes."""

from __future__ import annotations

import shlex
import shutil
from pathlib import Path
from unittest import mock

import pytest
import typer
from commands import (
    FIT_FILES,
    JOINTS,
    LEG,
    SAMPLES,
    TRAIN,
    VALIDATE,
    csv_text,
    fitted,
    idtool,
    installed,
    sample_table,
)

from idtool import __version__
from idtool.cli import app
from idtool.common.number_text import number

COMMANDS = typer.main.get_command(app).commands  # type: ignore[attr-defined]
NAMES = sorted(COMMANDS)

OPTIONS = {  # that every version keeps
    "fit": {"--config", "--out", "--json", "--quiet", "--holdout", "--validate", "--max-rms"},
    "validate": {"--config", "--out", "--json", "--quiet", "--prior", "--max-rms"},
    "inspect": {"--config", "--json", "--quiet"},
}


def help_of(*command: str) -> str:
    """A help text, its line breaks taken out."""
    done = idtool(*command, "--help")
    assert done.code == 0
    assert done.err == ""
    return " ".join(done.out.split())


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a robot and logs under the names that the examples give them."""
    folder = tmp_path_factory.mktemp("user")
    for name in ("leg.urdf", "leg.yaml"):
        shutil.copy(SAMPLES / name, folder)
    for name, log in {"run1.mcap": TRAIN, "run2.mcap": TRAIN, "run3.mcap": VALIDATE}.items():
        (folder / name).symlink_to(log)
    return folder


def test_help_names_every_command_and_says_what_it_does() -> None:
    text = help_of()
    assert set(OPTIONS) <= set(NAMES)
    for name in NAMES:
        summary = COMMANDS[name].help.split(";")[0].split(".")[0]
        assert f"{name} {summary}" in text


@pytest.mark.parametrize("name", NAMES)
def test_help_explains_every_option(name: str) -> None:
    text = help_of(name)
    options = {opt for parameter in COMMANDS[name].params for opt in parameter.opts}
    assert OPTIONS.get(name, set()) <= options
    for parameter in COMMANDS[name].params:
        assert (parameter.metavar if parameter.param_type_name == "argument" else parameter.opts[-1]) in text
        if parameter.name != "help":
            assert " ".join(parameter.help.split()) in text


def test_the_help_lists_the_commands_in_the_order_in_which_they_are_needed() -> None:
    text = help_of()
    names = ("First steps: sample", "inspect", "init", "Identify and check: fit", "diagnose")
    places = [text.index(f" {name} ") for name in names]
    assert places == sorted(places)


def test_a_mistake_in_a_command_names_the_help_of_that_command() -> None:
    assert idtool("fit").err == "error: command: missing argument 'URDF'; try idtool fit --help\n"
    assert idtool("fot").err == "error: command: no such command 'fot'. Did you mean 'fit'? Try idtool --help\n"
    option = idtool("fit", "--outt", "x").err
    assert option.startswith("error: command: no such option: --outt; did you mean --")
    assert option.endswith("? Try idtool fit --help\n")
    assert idtool("fit", "--zzz").err == "error: command: no such option: --zzz; try idtool fit --help\n"


def test_no_arguments_show_the_help() -> None:
    done = idtool()
    assert (done.code, done.err) == (0, "")
    assert done.out == idtool("--help").out


def test_every_commands_example_runs_as_it_is_written(folder: Path) -> None:
    for name in ("inspect", "fit", "validate"):
        label, _, example = COMMANDS[name].epilog.partition(": ")
        program, command, *arguments = shlex.split(example)
        assert (label, program, command) == ("Example", "idtool", name)
        done = idtool(command, *arguments, folder=folder)
        assert (done.code, done.err) == (0, "")
    assert {path.name for path in (folder / "leg_idtool").iterdir()} >= FIT_FILES


@pytest.mark.parametrize("name", NAMES)
def test_every_command_has_an_example(name: str) -> None:
    assert COMMANDS[name].epilog.startswith(f"Example: idtool {name} ")
    arguments = shlex.split(COMMANDS[name].epilog)[3:]
    COMMANDS[name].make_context(name, arguments)  # raises where one of them is unknown


def test_version() -> None:
    assert idtool("--version").out == f"idtool {__version__}\n"


def test_the_installed_command(folder: Path) -> None:
    done = installed("fit", "leg.urdf", "run1.mcap", "--quick", "--out", "out", "--max-rms", "9", folder=folder)
    assert (done.code, done.err) == (0, "")
    assert {path.name for path in (folder / "out").iterdir()} == FIT_FILES
    done = installed("validate", "out/identified.urdf", "run3.mcap", "--out", "out", "--max-rms=.01", folder=folder)
    assert (done.code, done.err) == (1, "")
    assert "bound not met: overall" in done.out
    done = installed("fit", "leg.urdf", "run9.mcap", "--out", "out", folder=folder)
    assert (done.code, done.out, done.err) == (
        2,
        "",
        "error: run9.mcap: there is no such file; did you mean run3.mcap?\n",
    )


def test_quiet_prints_nothing(folder: Path) -> None:
    for command in (["fit", "leg.urdf", "run1.mcap"], ["validate", "leg.urdf", "run3.mcap"], ["inspect", "run1.mcap"]):
        done = idtool(*command, "--quiet", folder=folder)
        assert (done.code, done.out, done.err) == (0, "", "")


def test_quiet_still_prints_errors(folder: Path) -> None:
    done = idtool("fit", "leg.urdf", "none.mcap", "--quiet", folder=folder)
    assert (done.code, done.out) == (2, "")
    assert done.err == "error: none.mcap: there is no such file; check the path\n"


@pytest.mark.parametrize(
    "command",
    [
        ["fit", LEG, TRAIN, "--quick", "--max-rms", "0.01"],
        ["validate", LEG, VALIDATE, "--max-rms", "0.01"],
        ["inspect", TRAIN],
    ],
    ids=lambda command: command[0],
)
def test_json_is_all_there_is_on_standard_output(tmp_path: Path, command: list[object]) -> None:
    done = idtool(*command, "--json", folder=tmp_path)
    assert done.code == (1 if "--max-rms" in command else 0)
    assert list(done.json)[:2] == ["idtool", "schema"]
    assert done.err != ""
    quiet = idtool(*command, "--json", "--quiet", folder=tmp_path)
    assert quiet.err == ""
    assert quiet.json.keys() == done.json.keys()


def test_tables_name_every_joint_and_body(tmp_path: Path) -> None:
    report = fitted(tmp_path / "json", LEG, TRAIN)
    done = idtool("fit", LEG, TRAIN, "--quick", folder=tmp_path)
    words = done.out.split()
    assert {*JOINTS, "overall", *report["bodies"]} <= set(words)
    assert number(report["rms"]["validation"]["overall"]) in words
    assert "written: leg_idtool/identified.urdf, model.yaml, report.json, report.html" in done.out


def test_a_name_is_not_taken_for_markup(tmp_path: Path) -> None:
    names, *samples = sample_table(1500)
    renamed = [name.replace("hip", "[bold]hip[/]") for name in names]
    (tmp_path / "log.csv").write_text(csv_text([renamed, *samples]))
    done = idtool("inspect", tmp_path / "log.csv")
    assert done.code == 0
    assert "[bold]hip[/]" in done.out


@pytest.mark.parametrize(("options", "limit"), [(["--jobs", 1], 1), ([], None)], ids=["one", "default"])
def test_jobs_limit_the_processes(tmp_path: Path, options: list[object], limit: int | None) -> None:
    with mock.patch("idtool.common.processes.limit_processes") as set_limit:
        assert idtool("fit", LEG, TRAIN, "--quick", "--quiet", *options, "--out", tmp_path).code == 0
    set_limit.assert_called_once_with(limit)
