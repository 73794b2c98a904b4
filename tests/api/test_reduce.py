"""Files of `idtool reduce`: fits from them are those from the logs; what does not fit or is damaged is refused."""

from __future__ import annotations

import dataclasses
import io
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import LEG, TRAIN, VALIDATE, idtool
from figures import assert_same_figures
from paths import SAMPLES

import idtool as package
from idtool.data.logs.log import Channel
from idtool.estimation.saved_reduction import read_reduction, write_reduction

OTHERS = "give the log (fit, validate, study and diagnose take reductions)"
FIGURES = ("bodies", "friction", "friction_intervals", "rms", "rms_raw", "noise", "samples", "regularization", "nrms")
UNCERTAINTY = ("torque_standard_error", "torque_standard_error_largest", "torque_undetermined", "independent_samples")


@pytest.fixture(scope="module")
def reduction(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample leg's log, reduced."""
    file = tmp_path_factory.mktemp("reduced") / "train.idr"
    package.reduce(LEG, TRAIN, file)
    return file


@pytest.fixture(scope="module")
def validation(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The sample leg's other log, reduced."""
    file = tmp_path_factory.mktemp("reduced") / "validate.idr"
    package.reduce(LEG, VALIDATE, file, holdout=0.0)
    return file


def settings(**changes: object) -> dict[str, Any]:
    """The sample leg's configuration with changes."""
    config = yaml.safe_load((SAMPLES / "leg.yaml").read_text())
    return {**config, **changes}


PRIORS: dict[str, dict[str, Any]] = {
    "as configured": {},
    "another weight": {"regularization": {"kind": "entropic", "weight": 0.01}},
    "another prior": {"regularization": {"kind": "euclidean", "weight": 1e-3}},
    "another constraint set": {"constraints": "full"},
    "a known mass": {"known": {"total_mass": 5.0}},
}


@pytest.mark.parametrize("changes", PRIORS.values(), ids=PRIORS)
def test_a_fit_is_that_from_the_log(reduction: Path, changes: dict[str, Any]) -> None:
    model = package.Model(LEG, settings(**changes))
    from_log = package.fit(model, TRAIN, quick=True).to_json()
    from_reduction = package.fit(model, reduction, quick=True).to_json()
    for key in FIGURES:
        assert_same_figures(from_reduction[key], from_log[key], key)
    for key in UNCERTAINTY:
        assert_same_figures(from_reduction["uncertainty"][key], from_log["uncertainty"][key], key)


def test_a_full_fit_says_what_it_cannot_do(reduction: Path) -> None:
    """The sources of the parameters are there; simulation and the check for bias need the samples."""
    result = package.fit(LEG, reduction)
    assert result.base_parameters is not None
    assert result.simulation is None
    (notice,) = [notice for notice in result.notices if notice.code == "bias_unchecked"]
    assert "needs the logs" in notice.message


def test_two_logs_are_compared(reduction: Path, validation: Path) -> None:
    """Each of them has been reduced alone."""
    both = package.fit(LEG, [reduction, validation])
    assert both.repeatability is not None
    assert set(both.repeatability.logs) == {TRAIN.name, VALIDATE.name}


def test_a_log_is_left_out_for_validation(reduction: Path, validation: Path) -> None:
    """Then nothing is held out of the other, though a part of it was when it was reduced."""
    own = package.fit(LEG, reduction, validate=validation, quick=True)
    from_logs = package.fit(LEG, TRAIN, validate=VALIDATE, quick=True)
    assert own.samples.validation == from_logs.samples.validation
    assert own.samples.train == pytest.approx(from_logs.samples.train, rel=0.02)  # the filter's ends are lost
    for name, body in from_logs.bodies.items():
        assert own.bodies[name].mass == pytest.approx(body.mass, rel=0.02)
    assert own.rms.validation["overall"] == pytest.approx(from_logs.rms.validation["overall"], rel=0.02)


def moved_hip(urdf: str) -> str:
    """The URDF with its hip a centimetre elsewhere."""
    joint = urdf.index('<joint name="hip"')
    start = urdf.index('xyz="', joint) + len('xyz="')
    return f"{urdf[:start]}0.01 {urdf[start:].split(maxsplit=1)[1]}"


SPRING = {"effect": "parallel_spring", "joint": "knee", "parameters": {"stiffness": 1.0, "rest_position": 0.0}}
CHANGES: dict[str, tuple[dict[str, Any], str]] = {
    "filter": ({"filter": {"cutoff_hz": 20.0}}, "filter.cutoff_hz: 40.0, which is now 20.0"),
    "order": ({"filter": {"order": 2}}, "filter.order: 4, which is now 2"),
    "gravity": ({"gravity": [0, 0, -1.62]}, "gravity: "),
    "friction": ({"friction": {"offset": True}}, "friction.abad: "),
    "velocity": ({"velocity": "differentiated"}, "velocity: auto, which is now differentiated"),
    "effect": ({"effects": [SPRING]}, "effects: "),
    "joints": ({"joints": ["hip", "knee"]}, "joints: "),
}


@pytest.mark.parametrize(("changes", "reason"), CHANGES.values(), ids=CHANGES)
def test_other_rows_are_refused_with_the_reason(reduction: Path, changes: dict[str, Any], reason: str) -> None:
    with pytest.raises(package.LogError) as refusal:
        package.fit(package.Model(LEG, settings(**changes)), reduction)
    assert f"train.idr: was made with {reason}" in str(refusal.value)
    assert str(refusal.value).endswith("; make it again with idtool reduce")


def test_another_geometry_is_refused(reduction: Path, tmp_path: Path) -> None:
    """But other inertias are a prior, which may be another one."""
    urdf, config = tmp_path / "leg.urdf", tmp_path / "leg.yaml"
    config.write_text((SAMPLES / "leg.yaml").read_text())
    urdf.write_text(moved_hip(LEG.read_text()))
    refusal = idtool("fit", urdf, reduction, "--out", tmp_path / "out")
    assert refusal.code == 2
    assert refusal.err.startswith(f"error: {reduction}: was made with urdf.hip.position: ")
    assert refusal.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
    urdf.write_text(LEG.read_text().replace('mass value="', 'mass value="1'))
    assert idtool("fit", urdf, reduction, "--quick", "--out", tmp_path / "out").code == 0


def damaged(change: Callable[[bytes], bytes]) -> Callable[[Path], bytes]:
    return lambda file: change(file.read_bytes())


def rewritten(member: str, change: Callable[[bytes], bytes], compression: int = zipfile.ZIP_STORED) -> Any:
    """A file with one of its members changed."""

    def rewrite(file: Path) -> bytes:
        output = io.BytesIO()
        with zipfile.ZipFile(file) as old, zipfile.ZipFile(output, "w", compression) as new:
            for name in old.namelist():
                data = old.read(name)
                new.writestr(name, change(data) if name == member else data)
        return output.getvalue()

    return rewrite


def of_objects(data: bytes) -> bytes:
    """An array of pickled objects."""
    output = io.BytesIO()
    np.save(output, np.array([print], dtype=object), allow_pickle=True)
    return output.getvalue()


def header_with(**changes: object) -> Callable[[bytes], bytes]:
    return lambda data: json.dumps({**json.loads(data), **changes}).encode()


ARRAY = "arrays.bin"
DAMAGE: dict[str, Callable[[Path], bytes]] = {
    "empty": damaged(lambda data: b""),
    "text": damaged(lambda data: b"t,q_hip\n0,1\n"),
    "cut off": damaged(lambda data: data[: len(data) // 2]),
    "a byte changed": damaged(lambda data: data[:5000] + bytes([data[5000] ^ 1]) + data[5001:]),
    "compressed": rewritten("header.json", lambda data: data, zipfile.ZIP_DEFLATED),
    "pickled objects": rewritten(ARRAY, of_objects),
    "a shorter array": rewritten(ARRAY, lambda data: data[:-800]),
    "no array": rewritten(ARRAY, lambda data: b""),
    "no JSON": rewritten("header.json", lambda data: b"{"),
    "a list": rewritten("header.json", lambda data: b"[1]"),
    "another format": rewritten("header.json", header_with(format="another")),
    "no excerpts": rewritten("excerpts.bin", lambda data: b""),
    "no logs": rewritten("header.json", header_with(logs=None)),
    "settings that are none": rewritten("header.json", header_with(settings=3)),
    "numbers that are none": rewritten("header.json", header_with(band_hz="wide")),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE)
def test_a_damaged_file_is_refused_in_one_line(
    reduction: Path, tmp_path: Path, damage: Callable[[Path], bytes]
) -> None:
    file = tmp_path / "log.idr"
    file.write_bytes(damage(reduction))
    result = idtool("diagnose", LEG, file, "--out", tmp_path / "out")
    assert result.code == 2
    assert result.err == f"error: {file}: is not a reduction, or is damaged; make it again with idtool reduce\n"


def test_random_damage_never_gives_a_traceback(reduction: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    data = np.frombuffer(reduction.read_bytes(), np.uint8)
    file = tmp_path / "log.idr"
    places = [*rng.integers(0, len(data), 6), *(len(data) - rng.integers(1, 4000, 8))]
    for place in places:
        changed = data.copy()
        changed[place] ^= rng.integers(1, 256)
        file.write_bytes(changed.tobytes())
        result = idtool("fit", LEG, file, "--quick", "--quiet", "--out", tmp_path / "out")
        assert result.code in (0, 2), place
        assert result.err.count("\n") == (1 if result.code else 0), place


def test_a_later_format_is_named(reduction: Path, tmp_path: Path) -> None:
    file = tmp_path / "log.idr"
    file.write_bytes(rewritten("header.json", header_with(version=99))(reduction))
    with pytest.raises(package.LogError, match="has version 99 of the format"):
        package.fit(LEG, file)


@pytest.mark.parametrize("command", ["adapt", "simulate", "inspect"])
def test_other_commands_need_the_log(reduction: Path, tmp_path: Path, command: str) -> None:
    arguments = [reduction] if command == "inspect" else [LEG, reduction, "--out", tmp_path / "out.csv"]
    result = idtool(command, *arguments)
    assert result.code == 2
    assert result.err == f"error: {reduction}: is a reduction of a log; {OTHERS}\n"


def with_spring(file: Path, stiffness: float, source: Path = TRAIN) -> Path:
    """A log of the sample leg with a spring at the knee, written to a file."""
    log = package.Log(source)
    tau = log.tau.copy()
    tau[:, 2] += stiffness * log.q[:, 2]
    return package.Log.from_arrays(file.name, log.t, log.joints, q=log.q, v=log.v, tau=tau).save(file)


SEARCH = {"effects": ["parallel_spring", "quadratic_drag"], "simulation": False}


@pytest.mark.slow
def test_a_diagnosis_of_a_short_log_is_that_of_the_log(tmp_path: Path) -> None:
    """A reduction keeps all samples of it."""
    log = with_spring(tmp_path / "spring.mcap", 3.0)
    package.reduce(LEG, log, tmp_path / "spring.idr")
    of_log = package.diagnose(LEG, log, **SEARCH).to_json()
    of_reduction = package.diagnose(LEG, tmp_path / "spring.idr", **SEARCH).to_json()
    assert [(step["effect"], step["joint"]) for step in of_reduction["steps"]] == [("parallel_spring", "knee")]
    for key in ("steps", "before", "after", "noise_floor", "verdict", "logs", "data_faults", "notices"):
        assert of_reduction[key] == of_log[key], key


@pytest.mark.slow
def test_a_diagnosis_of_long_logs_uses_windows_of_them(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Half of each log is enough to name the spring and to tell its stiffness; what is between is no lost time."""
    monkeypatch.setattr("idtool.estimation.dataset.reduced_logs._EXCERPT_SECONDS", (10.0, 10.0))
    monkeypatch.setattr("idtool.estimation.dataset.reduced_logs._WINDOW_SECONDS", 1.0)
    logs = [with_spring(tmp_path / source.name, 3.0, source) for source in (TRAIN, VALIDATE)]
    package.reduce(LEG, logs, tmp_path / "both.idr")
    result = package.diagnose(LEG, tmp_path / "both.idr", **SEARCH)
    (step,) = result.steps
    assert (step.effect, step.joint) == ("parallel_spring", "knee")
    assert step.parameters["stiffness"] == pytest.approx(3.0, rel=0.05)
    assert not [fault for fault in result.data_faults if fault.fault == "dropped_samples"]
    (notice,) = [notice for notice in result.notices if notice.code == "excerpts_used"]
    assert notice.message.startswith("only 10 s of the ")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("idtool.estimation.reduction_excerpts._MAX_SECONDS", 5.0)
        of_one = package.diagnose(LEG, tmp_path / "both.idr", **SEARCH)
    assert of_one.logs == (str(logs[0]),)


def test_a_reduction_that_is_given_twice_is_named(reduction: Path) -> None:
    result = package.diagnose(LEG, [reduction, reduction], effects=["parallel_spring"], simulation=False)
    assert "duplicate_log" in [notice.code for notice in result.notices]


def test_a_diagnosis_holds_out_what_it_is_told(reduction: Path) -> None:
    """An excerpt does not depend on what the reduction holds out."""
    result = package.diagnose(LEG, reduction, holdout=0.5, **SEARCH)
    assert result.samples.train == pytest.approx(result.samples.validation, rel=0.05)


def test_a_url_of_a_simulator_that_cannot_be_read_is_one_line_without_secrets() -> None:
    with pytest.raises(package.IdtoolError) as refusal:
        package.diagnose(LEG, TRAIN, against="https://user:word@127.0.0.1:9/log.mcap?key=SECRET")
    assert "SECRET" not in str(refusal.value)


def test_no_logs_are_one_line() -> None:
    with pytest.raises(package.LogError, match="no log given"):
        package.fit(LEG, [], skip_bad=True)


def test_an_empty_channel_is_written(reduction: Path, tmp_path: Path) -> None:
    saved = read_reduction(reduction, with_excerpts=True)
    (log,) = saved.logs
    assert log.excerpt is not None
    silent = dataclasses.replace(log.excerpt, channels={"contact_foot": Channel(np.zeros(0), np.zeros(0))})
    with_channel = dataclasses.replace(saved, logs=(dataclasses.replace(log, excerpt=silent),))
    write_reduction(tmp_path / "silent.idr", with_channel)
    (again,) = read_reduction(tmp_path / "silent.idr", with_excerpts=True).logs
    assert again.excerpt is not None
    assert len(again.excerpt.channels["contact_foot"].t) == 0
    np.testing.assert_array_equal(again.excerpt.signals["q"], silent.signals["q"])


def test_reductions_without_samples_and_of_logs_read_otherwise_are_refused(reduction: Path, tmp_path: Path) -> None:
    write_reduction(tmp_path / "none.idr", read_reduction(reduction))
    with pytest.raises(package.LogError, match=r"has no excerpt of leg_train\.mcap; make it again with idtool reduce"):
        package.diagnose(LEG, tmp_path / "none.idr")
    scaled = package.Model(LEG, settings(log={"scale": {"tau": {"hip": 2.0}}}))
    with pytest.raises(package.LogError, match=r"was made with another log\.scale"):
        package.diagnose(scaled, reduction)
    with pytest.raises(package.ConfigError, match="--against: needs the logs themselves"):
        package.diagnose(LEG, reduction, against=VALIDATE)


def test_logs_and_reductions_are_fitted_together(reduction: Path, validation: Path) -> None:
    """Logs are reduced in passing; for validation, too."""
    expected = package.fit(LEG, [reduction, validation], quick=True).to_json()
    holdout_kept = package.fit(LEG, [TRAIN, validation], quick=True).to_json()
    for key in FIGURES:
        assert_same_figures(holdout_kept[key], expected[key], key)
    validated = package.fit(LEG, TRAIN, validate=validation, quick=True).to_json()
    from_logs = package.fit(LEG, TRAIN, validate=VALIDATE, quick=True).to_json()
    for key in ("bodies", "rms", "samples"):
        assert_same_figures(validated[key], from_logs[key], key)


@pytest.fixture
def few_problems(monkeypatch: pytest.MonkeyPatch) -> None:
    """Studies with one prior, two curves, and each problem solved once."""
    for name, value in (("LOCAL", {}), ("PRIORS", ("euclidean",)), ("CURVES", ("none", "full")), ("_REPEATS", 1)):
        monkeypatch.setattr(f"idtool.estimation.study.study.{name}", value)


@pytest.mark.slow
@pytest.mark.usefixtures("few_problems")
def test_a_study_is_that_of_the_logs(reduction: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From logs reduced one by one, of which fewer rows are kept in a study of both, and from one of each kind."""
    monkeypatch.setattr("idtool.estimation.dataset.reduced_logs._DRAWN_ROWS", (64, 1000))
    monkeypatch.setattr("idtool.estimation.dataset.reduced_logs._DRAWN_BYTES", 1 << 20)
    files = [tmp_path / "train.idr", tmp_path / "validate.idr"]
    for log, file in zip((TRAIN, VALIDATE), files, strict=True):
        package.reduce(LEG, log, file)
    expected = package.study(LEG, [TRAIN, VALIDATE], draws=5).to_json()
    assert expected["learning"]["counts"][-2:] < [1000, 3000]  # not all rows can be drawn
    assert expected["adaptation"]["error"]
    for logs in (files, [TRAIN, files[1]]):
        result = package.study(LEG, logs, draws=5)
        own = result.to_json()
        for key in ("learning", "samples", "band_hz", "logs"):
            assert_same_figures(own[key], expected[key], key)
        for kind in ("sets", "estimators"):
            for name, entry in expected[kind].items():
                for figure in ("rms", "masses", "violations", "worst_margin"):
                    if figure in entry:
                        assert_same_figures(own[kind][name][figure], entry[figure], f"{name} {figure}")
        assert own["adaptation"] == {"t": [], "error": {}, "time_to_10_percent": {}, "forgetting": None}
        (notice,) = [notice for notice in result.notices if notice.code == "online_left_out"]
        assert notice.advice == "give the logs, or use idtool adapt"


@pytest.mark.usefixtures("few_problems")
def test_the_page_of_a_study_of_reductions(reduction: Path, validation: Path, tmp_path: Path) -> None:
    """Without the convergence of the online estimate."""
    done = idtool("study", LEG, reduction, "--validate", validation, "--draws", 5, "--out", tmp_path)
    assert done.code == 0
    assert "Online: " not in done.out
    page = (tmp_path / "study.html").read_text()
    assert "<h2>Constraint sets</h2>" in page
    assert "<h2>Online</h2>" not in page
    report = json.loads((tmp_path / "study.json").read_text())
    assert report["samples"]["validation"] > report["samples"]["train"] * 0.9


@pytest.mark.slow
@pytest.mark.usefixtures("few_problems")
def test_a_study_leaves_out_bad_logs(reduction: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("t,q_hip\n0,1\n")
    arguments = ("study", LEG, reduction, VALIDATE, bad, "--draws", 5, "--out", tmp_path / "out", "--quiet")
    refusal = idtool(*arguments)
    assert (refusal.code, refusal.err.count("\n")) == (2, 1)
    done = idtool(*arguments, "--skip-bad", "--json")
    assert done.code == 0
    assert done.json["logs"] == [str(TRAIN), str(VALIDATE)]
    assert [notice["subject"] for notice in done.json["notices"] if notice["code"] == "log_left_out"] == ["bad.csv"]


@pytest.mark.parametrize("cluster", [None, pytest.param("local:1", marks=pytest.mark.slow)])
def test_reductions_are_enough_if_no_log_can_be_used(
    reduction: Path, validation: Path, tmp_path: Path, cluster: str | None
) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_text("t,q_hip\n0,1\n")
    for logs, validate in (([bad, reduction], []), ([reduction], [bad, validation]), ([bad, reduction], [validation])):
        fitted = package.fit(LEG, logs, validate=validate, quick=True, skip_bad=True, cluster=cluster)
        assert [notice.subject for notice in fitted.notices if notice.code == "log_left_out"] == ["bad.csv"]
        expected = package.fit(LEG, reduction, validate=[validation] if validate else [], quick=True)
        assert_same_figures(fitted.to_json()["rms"], expected.to_json()["rms"], "rms")
    for logs, validate in (([bad], [validation]), ([reduction], [bad])):
        with pytest.raises(package.LogError, match="no other log can be used"):
            package.fit(LEG, logs, validate=validate, quick=True, skip_bad=True, cluster=cluster)


def test_a_damaged_reduction_is_left_out(reduction: Path, validation: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.idr"
    bad.write_bytes(reduction.read_bytes()[:5000])
    fitted = package.fit(LEG, [bad, reduction], validate=[validation, bad], quick=True, skip_bad=True)
    assert [notice.subject for notice in fitted.notices if notice.code == "log_left_out"] == ["bad.idr"]
    assert_same_figures(
        fitted.to_json()["rms"], package.fit(LEG, reduction, validate=validation, quick=True).to_json()["rms"], "rms"
    )
    for logs, validate in (([bad], [validation]), ([reduction], [bad])):
        with pytest.raises(package.LogError, match=r"bad\.idr: .*; no other log can be used"):
            package.fit(LEG, logs, validate=validate, quick=True, skip_bad=True)
    with pytest.raises(package.LogError, match=r"bad\.idr"):
        package.fit(LEG, [bad, reduction], quick=True)


def test_a_validation_is_that_on_the_log(validation: Path, tmp_path: Path) -> None:
    """Of an identified model, too, whose rows are those of the original one."""
    package.fit(LEG, TRAIN, quick=True).save(tmp_path)
    for model, prior in ((LEG, None), (tmp_path / "identified.urdf", LEG)):
        own = package.validate(model, validation, prior=prior).to_json()
        expected = package.validate(model, VALIDATE, prior=prior, simulation=False).to_json()
        for key in ("rms", "rms_raw", "nrms", "samples"):
            assert_same_figures(own[key], expected[key], key)
        assert own["simulation"] is None


def test_another_holdout_is_refused(reduction: Path, tmp_path: Path) -> None:
    result = idtool("fit", LEG, reduction, "--holdout", 0.5, "--out", tmp_path / "out")
    assert result.code == 2
    assert "--holdout" in result.err
    assert "--holdout 0.3" in result.err


def test_instruments_need_the_log(reduction: Path) -> None:
    with pytest.raises(package.ConfigError, match="--method iv: needs the logs"):
        package.fit(LEG, reduction, method="iv")


def test_a_wrong_name_is_refused_before_the_work(tmp_path: Path) -> None:
    result = idtool("reduce", LEG, TRAIN, "--out", tmp_path / "train.mcap")
    assert result.code == 2
    assert result.err == f"error: --out: {tmp_path / 'train.mcap'} does not end in .idr; give a file that does\n"


def test_what_the_command_says(tmp_path: Path) -> None:
    file = tmp_path / "leg.idr"
    result = idtool("reduce", LEG, TRAIN, VALIDATE, "--holdout", 0.2, "--out", file, "--json")
    assert result.code == 0
    assert [log["path"] for log in result.json["logs"]] == [str(TRAIN), str(VALIDATE)]
    assert result.json["bytes"] == file.stat().st_size
    assert result.json["holdout"] == 0.2
    assert sorted(path.name for path in tmp_path.iterdir()) == ["leg.idr"]


SENSORS: dict[str, dict[str, Any]] = {
    "effects": {"effects": [{"effect": "torque_gain", "joint": "knee", "parameters": {"gain": 1.1}}]},
    "contacts": {"contacts": [{"name": "foot", "link": "shank_link", "point": [0, 0, -0.2], "flag": "contact_foot"}]},
}


@pytest.mark.parametrize(("key", "changes"), SENSORS.items(), ids=SENSORS)
def test_rows_that_depend_on_the_fit_are_refused(tmp_path: Path, key: str, changes: dict[str, Any]) -> None:
    with pytest.raises(package.IdtoolError) as refusal:
        package.reduce(package.Model(LEG, settings(**changes)), TRAIN, tmp_path / "leg.idr")
    assert key in str(refusal.value)
    assert not (tmp_path / "leg.idr").exists()
