"""`import idtool`: cheap, complete and typed; logs and models as a user makes them; what the documents show runs."""

from __future__ import annotations

import contextlib
import doctest
import io
import pickle
import pkgutil
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import JOINTS, LEG, SAMPLES, TRAIN, VALIDATE_CSV, config_with, csv_text, sample_table
from paths import CHECKOUT
from threadpoolctl import threadpool_info, threadpool_limits

import idtool
from idtool.data.logs import read_log

API = ("data", "diagnose", "fit", "log", "model", "results", "simulate", "validate")


@pytest.fixture
def beside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working directory with the sample logs in it, as in the repository's root."""
    (tmp_path / "sample_logs").symlink_to(SAMPLES)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def python(script: str) -> str:
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout


def test_the_import_does_not_wait_for_the_numerics() -> None:
    heavy = "{'numpy', 'scipy', 'plotly', 'lxml', 'pydantic', 'typer', 'rich'}"
    assert python(f"import sys, idtool; print(*{heavy} & set(sys.modules))").split() == []


def test_functions_are_not_hidden_by_modules() -> None:
    assert {module.name for module in pkgutil.iter_modules(idtool.__path__)} & set(idtool.__all__) == set()
    for name in ("cli", "estimation.fit", "diagnosis.diagnose", "api.fit", "api.validate", "api.simulate"):
        import_module(f"idtool.{name}")
    assert all(map(callable, (idtool.fit, idtool.validate, idtool.simulate, idtool.diagnose)))


def test_every_public_name_is_there_and_described() -> None:
    assert sorted(idtool.__all__) == dir(idtool)
    for name in set(idtool.__all__) - {"__version__"}:
        assert getattr(idtool, name).__doc__, name
    with pytest.raises(AttributeError, match="no attribute 'fitt'"):
        idtool.fitt  # type: ignore[attr-defined]  # noqa: B018


def test_a_log_is_what_the_reader_reads_and_cannot_be_changed() -> None:
    log, record = idtool.Log(TRAIN), read_log(TRAIN)
    assert (log.joints, log.signals, len(log)) == (JOINTS, ("q", "v", "tau"), 10_000)
    assert (log.segments, log.notices, log.path) == (record.segments, record.notices, TRAIN)
    np.testing.assert_array_equal(log.t, record.t)
    for name in ("q", "v", "tau"):
        np.testing.assert_array_equal(getattr(log, name), record.signals[name])
        with pytest.raises(ValueError, match="read-only"):
            getattr(log, name)[0, 0] = 1.0
    with pytest.raises(AttributeError):
        log.q = log.q  # type: ignore[misc]
    assert (log.qcmd, log.vcmd) == (None, None)
    assert log.rate == pytest.approx(1000)
    assert log.seconds == pytest.approx(log.t[-1] - log.t[0])
    assert repr(log) == "Log leg_train.mcap: 3 joints (abad, hip, knee), 10 s at 1000 Hz: q, v, tau"


def test_a_logs_options_are_the_readers(tmp_path: Path) -> None:
    table = sample_table(20)
    table[0] = ["current" if name == "tau_hip" else name for name in table[0]]
    (tmp_path / "log.csv").write_text(csv_text(table))
    columns, scale = {"tau_hip": "current"}, {"tau": {"hip": 0.5}}
    log = idtool.read_log(tmp_path / "log.csv", columns=columns, scale=scale)
    plain = idtool.Log(VALIDATE_CSV)
    assert log.tau is not None
    assert plain.tau is not None
    np.testing.assert_array_equal(log.tau, plain.tau[:20] * [1, 0.5, 1])


def test_a_log_from_arrays_goes_round_through_a_file(tmp_path: Path, rng: np.random.Generator) -> None:
    t, q = np.arange(100) / 500, rng.normal(size=(100, 2))
    log = idtool.Log.from_arrays("run", t, ["a", "b"], q=q, tau=2 * q)
    q[:] = 0  # a copy was taken
    assert repr(log) == "Log run: 2 joints (a, b), 0.198 s at 500 Hz: q, tau"
    again = idtool.Log(log.save(tmp_path / "run.mcap"))
    np.testing.assert_array_equal(again.q, log.q)
    np.testing.assert_array_equal(again.tau, 2 * log.q)
    assert np.abs(log.q).max() > 1


@pytest.mark.parametrize(
    ("changes", "error"),
    [
        ({"joints": ["a", "a"]}, "run: needs times of shape"),
        ({"t": [[0.0, 1.0]]}, "run: needs times of shape"),
        ({"q": [[0.0, 1.0]]}, r"run: q has the shape \(1, 2\); give \(3, 2\)"),
        ({"tau": [0.0, 1.0, 2.0]}, r"run: tau has the shape \(3,\); give \(3, 2\)"),
        ({"t": [0.0, 0.0, 0.0]}, "run: time does not advance"),
    ],
)
def test_arrays_that_are_no_log(changes: Mapping[str, Any], error: str) -> None:
    given: dict[str, Any] = {"t": [0.0, 0.1, 0.2], "joints": ["a", "b"], "q": np.zeros((3, 2))}
    with pytest.raises(idtool.LogError, match=error):
        idtool.Log.from_arrays("run", **{**given, **changes})


def test_gaps_are_not_counted() -> None:
    t = np.concatenate([np.arange(50), 500 + np.arange(50)]) / 100
    log = idtool.Log.from_arrays("run", t, ["a"], q=np.zeros((100, 1)))
    assert len(log.segments) == 2
    assert log.seconds == pytest.approx(0.98)
    assert "0.98 s at 100 Hz, 2 segments: q" in repr(log)


def test_a_model_takes_the_configuration_beside_it_or_another(tmp_path: Path) -> None:
    model = idtool.Model(LEG)
    assert model.joints == JOINTS
    assert model.bodies == ("abad_link", "thigh_link", "shank_link", "abad_rotor", "hip_rotor", "knee_rotor")
    assert dict(model.effects) == {"viscous_friction": JOINTS, "coulomb_friction": JOINTS}
    assert model.urdf == LEG.read_text()
    path = config_with(tmp_path / "other.yaml", joints=["hip"], friction={"viscous": False})
    spring = {"effect": "parallel_spring", "joint": "knee", "parameters": {"stiffness": 1.0, "rest_position": 0.0}}
    for other in (idtool.Model(LEG, path), idtool.Model(str(LEG), {"joints": ["hip"], "effects": [spring]})):
        assert other.joints == ("hip",)
        assert other.config["joints"] == ["hip"]
    assert "viscous_friction" not in idtool.Model(LEG, path).effects
    assert repr(other).splitlines()[0] == "Model leg.urdf with a configuration"
    assert repr(other).splitlines()[-1] == "  effects: viscous_friction, coulomb_friction, parallel_spring on knee"
    locked = idtool.Model(LEG, {"locked_joints": {"abad": 0.1}})
    assert locked.joints == ("hip", "knee")


def test_a_model_says_what_is_wrong_with_it(tmp_path: Path) -> None:
    with pytest.raises(idtool.ConfigError, match="config: unknown key 'joint'"):
        idtool.Model(LEG, {"joint": ["hip"]})
    with pytest.raises(idtool.ModelError, match=r"none\.urdf: cannot be read"):
        idtool.Model(tmp_path / "none.urdf")
    wrong = idtool.Model(LEG, {"joints": ["hpi"]})
    with pytest.raises(idtool.IdtoolError, match=r"hpi: is not an actuated joint of the URDF; did you mean hip\?"):
        wrong.bodies  # noqa: B018
    assert "cannot be used: joints: hpi: is not an actuated joint" in repr(wrong)


def test_a_log_read_otherwise_than_the_configuration_says_is_refused() -> None:
    model = idtool.Model(LEG, {**idtool.Model(LEG).config, "log": {"scale": {"tau": {"hip": 2.0}}}})
    with pytest.raises(idtool.LogError, match=r"leg_train\.mcap: was read without the setting log\.scale"):
        idtool.fit(model, idtool.Log(TRAIN), quick=True)
    log = model.read_log(TRAIN)
    plain = idtool.Log(TRAIN)
    assert log.tau is not None
    assert plain.tau is not None
    np.testing.assert_array_equal(log.tau[:, 1], 2 * plain.tau[:, 1])
    by_log, by_path = (idtool.fit(model, one, quick=True) for one in (log, TRAIN))
    assert by_log.rms.train["hip"] == by_path.rms.train["hip"]


@pytest.mark.parametrize("call", [partial(idtool.fit, LEG, TRAIN, quick=True), partial(idtool.init, LEG, TRAIN)])
def test_linear_algebra_has_one_thread_during_a_call_and_then_as_many_as_before(call: Callable[..., object]) -> None:
    """Its threads would wait for each other: without the limit, fits took four to ten times as long."""

    def thread_counts() -> dict[str, int]:
        libraries = [library for library in threadpool_info() if library["user_api"] == "blas"]
        return {library["filepath"]: library["num_threads"] for library in libraries}

    during: set[int] = set()
    with threadpool_limits(2, user_api="blas"):
        before = {path: count for path, count in thread_counts().items() if count == 2}  # some are built for one
        assert any("openblas" in path for path in before)
        call(progress=lambda stage, share: during.update(thread_counts().values()))
        after = thread_counts()
    assert during == {1}
    assert {path: after[path] for path in before} == before


def test_results_data_cannot_be_changed_but_copied() -> None:
    from idtool.reporting.results.base import ReadOnly

    data = ReadOnly({"a": (1, ReadOnly({"b": None}))})
    assert data == {"a": (1, {"b": None})}
    assert repr(data) == "{'a': (1, {'b': None})}"
    assert pickle.loads(pickle.dumps(data)) == data  # noqa: S301
    with pytest.raises(TypeError):
        data["a"] = 1  # type: ignore[index]


def test_examples_in_the_docstrings_are_true(beside: Path) -> None:
    modules = [idtool, *(import_module(f"idtool.api.{name}") for name in API)]
    finder, runner, tried = doctest.DocTestFinder(), doctest.DocTestRunner(), 0
    for module in modules:
        for test in finder.find(module, globs={"idtool": idtool}):
            with contextlib.redirect_stdout(io.StringIO()) as said:
                runner.run(test)
            assert runner.failures == 0, said.getvalue()
            tried += len(test.examples) > 0
    assert tried == 7  # the package, Log, Model and the four functions


def test_the_short_example_of_the_python_page_runs(beside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    page = CHECKOUT / "docs" / "pages" / "python.md"
    section = page.read_text().partition("## Quick start\n")[2].partition("\n## ")[0]
    (code,) = re.findall(r"```python\n(.*?)```", section, re.DOTALL)
    exec(compile(code, page.name, "exec"), {})  # noqa: S102
    assert {path.name for path in (beside / "out").iterdir()} == {
        *("identified.urdf", "model.yaml", "report.json", "report.html"),
    }
    assert "RMS torque error" in capsys.readouterr().out


def test_the_example_runs(beside: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = runpy.run_path(str(CHECKOUT / "docs" / "example.py"))
    assert left["diagnosis"].verdict == "no_disagreement"
    assert left["motion"].shape == (left["run"].log.q.shape[0], 3)
    assert (beside / "leg_idtool" / "simulated.mcap").is_file()
    assert "FitResult leg.urdf" in capsys.readouterr().out
