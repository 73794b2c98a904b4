"""Results of a fit are read from files that may be damaged, another version's, or a stranger's."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import LEG, TRAIN, fitted

from idtool.common.exceptions import IdtoolError, ModelError
from idtool.reporting import stored_fit
from idtool.reporting.stored_fit import read_fit

Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What a fit of the leg has written."""
    folder = tmp_path_factory.mktemp("fit") / "leg_idtool"
    fitted(folder, LEG, TRAIN)
    return folder


@pytest.fixture(scope="module")
def content(folder: Path) -> dict[str, Any]:
    """Its report."""
    data: dict[str, Any] = json.loads((folder / "report.json").read_text())
    return data


def refusal(path: Path) -> str:
    """The error that reading a result gives, checked to be one line that names the file."""
    with pytest.raises(ModelError) as caught:
        read_fit(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def changed(content: dict[str, Any], change: Change, tmp_path: Path) -> Path:
    """A file with a report that was changed."""
    data = copy.deepcopy(content)
    change(data)
    file = tmp_path / "report.json"
    file.write_text(json.dumps(data))
    return file


@pytest.mark.parametrize("given", ["", "report.json"])
def test_a_folder_or_its_report_is_read(folder: Path, content: dict[str, Any], given: str) -> None:
    result = read_fit(folder / given)
    assert result.report.to_json() == content
    assert result.config is not None
    assert result.config.joints == ("abad", "hip", "knee")
    assert [source.kind for source in result.sources] == ["report", "configuration"]


def test_a_report_alone_has_no_configuration(content: dict[str, Any], tmp_path: Path) -> None:
    assert read_fit(changed(content, lambda data: None, tmp_path)).config is None


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is not JSON"),
        (b"\x89PNG\r\n", "is not JSON"),
        (b"[" * 100_000, "is not JSON"),
        (b'{"rms": NaN}', "is not JSON"),
        (b"[]", "is not the result of idtool fit; give its report.json or its folder"),
        (b'{"schema": 1, "rms": {}}', "is not the result of idtool fit"),
        (b'{"schema": 1, "rms": {}, "bodies": {}, "solver": 1e999}', "numbers that are not finite"),
        (b'{"schema": 2, "rms": {}, "bodies": {}, "solver": {}}', "another schema version"),
        (b'{"schema": 1, "rms": {}, "bodies": {}, "solver": {}}', "is damaged, or of an idtool that differs too much"),
    ],
)
def test_what_is_no_report_is_refused(data: bytes, message: str, tmp_path: Path) -> None:
    file = tmp_path / "report.json"
    file.write_bytes(data)
    assert message in refusal(file)


def test_missing_files_are_named(folder: Path, tmp_path: Path) -> None:
    assert "contains no report.json; give a folder that idtool fit wrote" in refusal(tmp_path)
    assert "No such file" in refusal(tmp_path / "nowhere")
    assert "did you mean leg_idtool?" in refusal(folder.parent / "leg_idtol")


def test_a_large_file_is_refused(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stored_fit, "_MAX_BYTES", 1 << 10)
    assert "is larger than" in refusal(folder / "report.json")


def test_keys_of_other_versions_do_not_matter(content: dict[str, Any], tmp_path: Path) -> None:
    def change(data: dict[str, Any]) -> None:
        data["of_a_later_version"] = {"some": ["thing"]}
        data["bodies"]["shank_link"]["colour"] = "red"
        del data["noise_floor"]
        del data["controller_gains"]
        del data["effects"]
        del data["bodies"]["shank_link"]["split"]

    report = read_fit(changed(content, change, tmp_path)).report
    assert report.noise_floor is None
    assert dict(report.controller_gains) == {}
    assert report.effects == ()
    assert report.bodies["shank_link"].split is None
    assert report.bodies["shank_link"].mass == content["bodies"]["shank_link"]["mass"]


@pytest.mark.parametrize(
    "change",
    [
        lambda data: data.pop("verdict"),
        lambda data: data["units"].pop("hip"),
        lambda data: data["units"].update(hip="furlong"),
        lambda data: data["rms"]["train"].pop("overall"),
        lambda data: data["bodies"]["shank_link"]["pi"].pop(),
        lambda data: data["bodies"]["shank_link"]["interval"].pop(),
        lambda data: data["bodies"]["shank_link"]["com"].pop(),
        lambda data: data["bodies"]["shank_link"].update(mass="heavy"),
        lambda data: data["friction"]["hip"].update(viscous=10**400),
        lambda data: data.update(bodies=[]),
    ],
)
def test_a_damaged_report_is_refused(content: dict[str, Any], change: Change, tmp_path: Path) -> None:
    assert "is damaged" in refusal(changed(content, change, tmp_path))


def test_a_configuration_that_cannot_be_read_is_refused(content: dict[str, Any], tmp_path: Path) -> None:
    changed(content, lambda data: None, tmp_path)
    (tmp_path / "model.yaml").write_text("joints: [hip\n")
    with pytest.raises(IdtoolError, match=r"model\.yaml"):
        read_fit(tmp_path)
