"""Logs reduced by a cluster: results are those of one process, and nothing is lost when something fails."""

from __future__ import annotations

import functools
import http.server
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import dask.config
import numpy as np
import pytest
from commands import LEG, TRAIN, VALIDATE, idtool
from figures import assert_same_figures

import idtool as package
from idtool.common.cluster import _LOCAL_SETTINGS, open_cluster
from idtool.common.exceptions import ConfigError
from idtool.estimation import distributed_reduction

FIGURES = ("bodies", "friction", "friction_intervals", "rms", "rms_raw", "noise", "samples", "regularization", "nrms")
UNCERTAINTY = ("torque_standard_error", "torque_standard_error_largest", "torque_undetermined", "independent_samples")
_START_SECONDS = 60.0


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Parts of the sample leg's logs, of different lengths."""
    folder = tmp_path_factory.mktemp("logs")
    paths = []
    for source, cuts in ((TRAIN, (0, 2000, 5500, 10000)), (VALIDATE, (0, 3000, 10000))):
        log = package.Log(source)
        for start, stop in itertools.pairwise(cuts):
            part = slice(start, stop)
            name = f"run{len(paths)}"
            own = package.Log.from_arrays(
                name, log.t[part], log.joints, q=log.q[part], v=log.v[part], tau=log.tau[part]
            )
            paths.append(own.save(folder / f"{name}.mcap"))
    return paths


@pytest.fixture(scope="module")
def scheduler(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """File of a scheduler with two workers, each a process of its own."""
    folder = tmp_path_factory.mktemp("dask")
    file = folder / "scheduler.json"
    worker = [
        "worker",
        "--scheduler-file",
        str(file),
        "--nthreads",
        "1",
        "--no-dashboard",
        "--local-directory",
        str(folder),
    ]
    commands = [
        ["scheduler", "--scheduler-file", str(file), "--port", "0", "--no-dashboard", "--host", "127.0.0.1"],
        worker,
        worker,
    ]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    processes = []
    for command in commands:
        dask = [sys.executable, "-m", "dask", *command]
        processes.append(subprocess.Popen(dask, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))
    deadline = time.monotonic() + _START_SECONDS
    while not file.exists() and time.monotonic() < deadline:
        time.sleep(0.1)
    yield str(file)
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture(scope="module")
def from_logs(logs: list[Path]) -> package.FitResult:
    """The fit in this process."""
    return package.fit(LEG, logs, quick=True)


def assert_same_fit(fitted: package.FitResult, expected: package.FitResult) -> None:
    """Two fits agree in every figure but for rounding."""
    own, others = fitted.to_json(), expected.to_json()
    for key in FIGURES:
        assert_same_figures(own[key], others[key], key)
    for key in UNCERTAINTY:
        assert_same_figures(own["uncertainty"][key], others["uncertainty"][key], key)


def test_a_fit_is_that_of_one_process(scheduler: str, logs: list[Path], from_logs: package.FitResult) -> None:
    assert_same_fit(package.fit(LEG, logs, quick=True, cluster=scheduler), from_logs)


def test_a_fit_with_validation_logs_is_that_of_one_process(scheduler: str, logs: list[Path]) -> None:
    *train, last = logs
    fitted = package.fit(LEG, train, validate=last, quick=True, cluster=scheduler)
    assert_same_fit(fitted, package.fit(LEG, train, validate=last, quick=True))


def test_a_validation_is_that_of_one_process(scheduler: str, logs: list[Path]) -> None:
    own = package.validate(LEG, logs, cluster=scheduler).to_json()
    expected = package.validate(LEG, logs, simulation=False).to_json()
    for key in ("rms", "rms_raw", "nrms", "samples"):
        assert_same_figures(own[key], expected[key], key)


@pytest.mark.slow
def test_a_study_is_that_of_one_process(
    scheduler: str, logs: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, value in (("LOCAL", {}), ("PRIORS", ("euclidean",)), ("CURVES", ("none", "full")), ("_REPEATS", 1)):
        monkeypatch.setattr(f"idtool.estimation.study.study.{name}", value)
    expected = package.study(LEG, logs, draws=5).to_json()
    done = idtool("study", LEG, *logs, "--draws", 5, "--cluster", scheduler, "--out", tmp_path, "--json")
    assert done.code == 0
    for key in ("learning", "samples", "band_hz", "logs"):
        assert_same_figures(done.json[key], expected[key], key)
    assert len(list((tmp_path / "reductions").glob("*.idr"))) == len(logs)


@pytest.mark.slow
def test_a_diagnosis_searches_samples_of_each_log(scheduler: str, logs: list[Path], tmp_path: Path) -> None:
    """The logs are shorter than what is kept of them, so that it is the diagnosis of the logs."""
    bad = tmp_path / "bad.csv"
    bad.write_text("t,q_hip\n")
    arguments = ["diagnose", LEG, *logs, bad, "--skip-bad", "--effects", "parallel_spring", "--no-simulation", "--json"]
    done = idtool(*arguments, "--cluster", scheduler, "--out", tmp_path / "out")
    assert done.code == 0, done.err
    expected = idtool(*arguments, "--out", tmp_path / "expected").json
    for key in ("verdict", "steps", "before", "noise_floor", "logs"):
        assert_same_figures(done.json[key], expected[key], key)
    left_out = [notice["subject"] for notice in done.json["notices"] if notice["code"] == "log_left_out"]
    assert left_out == ["bad.csv"]
    assert len(list((tmp_path / "out" / "reductions").glob("*.idr"))) == len(logs)


@pytest.mark.parametrize("is_version_known", [True, False])
def test_a_process_on_this_machine_reduces_logs_to_one_file(
    logs: list[Path],
    from_logs: package.FitResult,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    is_version_known: bool,
) -> None:
    """Those of the single logs are removed, also of logs whose version a server does not tell."""
    if not is_version_known:
        monkeypatch.setattr(distributed_reduction, "version_of", lambda path: None)
    run = idtool("reduce", LEG, *logs, "--out", tmp_path / "all.idr", "--cluster", "local:1")
    assert run.code == 0, run.err
    assert list(tmp_path.iterdir()) == [tmp_path / "all.idr"]
    assert_same_fit(package.fit(LEG, tmp_path / "all.idr", quick=True), from_logs)


def test_logs_behind_urls(scheduler: str, logs: list[Path], from_logs: package.FitResult) -> None:
    handler = functools.partial(_QuietHandler, directory=str(logs[0].parent))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_address[1]}"
        urls = [f"{address}/{path.name}" for path in logs]
        fitted = package.fit(LEG, [f"{urls[0]}?signature=secret", *urls[1:]], quick=True, cluster=scheduler)
        inspected = idtool("inspect", f"{urls[1]}?signature=secret", "--json")
        missing = idtool("fit", LEG, f"{address}/run7.mcap", "--quick")
        log = package.Log(urls[0])
        server.shutdown()
    assert_same_fit(fitted, from_logs)
    assert fitted.logs == tuple(urls)
    assert "secret" not in str(fitted.to_json()) + inspected.out
    assert inspected.json["path"] == urls[1]
    assert log.path.name == "run0.mcap"
    assert missing.code == 2
    assert missing.err == f"error: {address}/run7.mcap: cannot be read: there is no such file; check the URL\n"
    assert missing.err.count("\n") == 1


class _QuietHandler(http.server.SimpleHTTPRequestHandler):
    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


def test_a_worker_that_is_killed_loses_nothing(logs: list[Path], from_logs: package.FitResult, tmp_path: Path) -> None:
    """While it reduces a log; another one takes its place."""
    killed = []

    def kill_a_worker(stage: str, share: float) -> None:
        if stage.startswith("reducing") and not killed:
            children = subprocess.run(["pgrep", "-P", str(os.getpid())], capture_output=True, text=True, check=True)
            pids = [int(line) for line in children.stdout.split()]
            workers = [pid for pid in pids if b"spawn_main" in Path(f"/proc/{pid}/cmdline").read_bytes()]
            killed.append(max(workers))
            os.kill(killed[0], signal.SIGKILL)

    fitted = package.fit(LEG, logs, quick=True, cluster="local:2", progress=kill_a_worker)
    assert killed
    assert_same_fit(fitted, from_logs)


def test_a_rerun_takes_up_what_is_there(scheduler: str, logs: list[Path], tmp_path: Path) -> None:
    """Reductions of other settings, or of a log that has changed, are made again, on this machine or on others."""
    first = package.fit(LEG, logs, quick=True, cluster=scheduler, reductions=tmp_path)
    files = sorted(tmp_path.iterdir())
    assert [file.name.split(".")[0] for file in files] == [log.stem for log in logs]
    files[1].unlink()
    files[2].write_bytes(b"not a reduction")
    (tmp_path / f".{files[1].name}.4711.part").write_bytes(b"from a worker that was killed")
    kept = {file: file.stat().st_mtime_ns for file in (files[0], *files[3:])}
    again = package.fit(LEG, logs, quick=True, cluster="local:1", reductions=tmp_path)
    assert sorted(tmp_path.iterdir()) == files
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert_same_fit(again, first)
    config = package.Model(LEG).config
    other_prior = package.Model(LEG, {**config, "regularization": {"kind": "euclidean", "weight": 1e-3}, "seed": 3})
    package.fit(other_prior, logs, quick=True, cluster=scheduler, reductions=tmp_path)
    assert {file: file.stat().st_mtime_ns for file in kept} == kept
    assert len(list(tmp_path.iterdir())) == len(logs)
    other_band = package.Model(LEG, {**config, "filter": {"cutoff_hz": 20.0}})
    package.fit(other_band, logs, quick=True, cluster=scheduler, reductions=tmp_path)
    assert len(list(tmp_path.iterdir())) == 2 * len(logs)


def test_a_log_that_has_changed_is_read_again(scheduler: str, logs: list[Path], tmp_path: Path) -> None:
    """However its path is written; of many settings, the newest reductions are kept."""
    changing = tmp_path / "changing.mcap"
    folder = tmp_path / "reductions"
    for i in range(5):
        changing.write_bytes(logs[i % len(logs)].read_bytes())
        given = [f"{tmp_path}/./changing.mcap", str(logs[0])]
        fitted = package.fit(LEG, given, quick=True, cluster=scheduler, reductions=folder)
        assert len(fitted.logs) == 2
    assert len(list(folder.glob("changing.*.idr"))) == 3
    assert len(list(folder.glob("run0.*.idr"))) == 1


def test_logs_that_cannot_be_used_are_named_or_left_out(
    scheduler: str, logs: list[Path], from_logs: package.FitResult, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(logs[0].read_bytes()[:100])
    other_joints = package.Log.from_arrays("other", np.arange(2000) / 1000, ["a"], q=np.zeros((2000, 1)))
    other = other_joints.save(tmp_path / "other.csv")
    given = [logs[0], bad, *logs[1:], other]
    for cluster in (["--cluster", scheduler], []):
        refused = idtool("fit", LEG, *given, "--quick", "--out", tmp_path / "out", *cluster)
        assert refused.code == 2
        assert refused.err.startswith(f"error: {bad}: ")
        assert refused.err.count("\n") == 1
        others = "other.csv cannot be used either; --skip-bad leaves such logs out"
        assert (others in refused.err) == bool(cluster)  # one process stops at the first
        assert not (tmp_path / "out" / "identified.urdf").exists()
    for cluster_address in (scheduler, None):
        fitted = package.fit(LEG, given, quick=True, cluster=cluster_address, skip_bad=True)
        left_out = [notice.subject for notice in fitted.notices if notice.code == "log_left_out"]
        assert sorted(left_out) == ["bad.mcap", "other.csv"]
        for name, body in from_logs.bodies.items():
            assert fitted.bodies[name].mass == pytest.approx(body.mass, rel=1e-3)


@pytest.mark.parametrize(("is_for_validation", "purpose"), [(False, "the fit"), (True, "validation")])
def test_where_no_log_is_left_the_error_says_for_what(
    scheduler: str, logs: list[Path], tmp_path: Path, is_for_validation: bool, purpose: str
) -> None:
    bad = tmp_path / "bad.mcap"
    bad.write_bytes(logs[0].read_bytes()[:100])
    fitted, validated = (logs[0], bad) if is_for_validation else (bad, logs[0])
    arguments = [fitted, "--validate", validated, "--quick", "--skip-bad", "--cluster", scheduler]
    refused = idtool("fit", LEG, *arguments, "--out", tmp_path / "out")
    assert refused.code == 2
    assert refused.err.startswith(f"error: {bad}: ")
    assert refused.err.endswith(f"; no other log can be used for {purpose}\n")


def test_clusters_that_cannot_be_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    no_scheduler = tmp_path / "other.json"
    no_scheduler.write_text("[]")
    monkeypatch.setattr("idtool.common.cluster._SECONDS_TO_CONNECT", 1)
    for address, words in {
        "local:0": "local:0 is not local:N",
        "local": "local is not local:N",
        "nonsense": "nonsense is not the address of a scheduler",
        "tcp://127.0.0.1:1": "no cluster at tcp://127.0.0.1:1",
        "missing.json": "missing.json cannot be read",
        str(no_scheduler): f"{no_scheduler} is not the file of a scheduler",
    }.items():
        refused = idtool("fit", LEG, TRAIN, "--cluster", address)
        assert refused.code == 2
        assert refused.err.startswith(f"error: --cluster: {words}")
        assert refused.err.count("\n") == 1


def test_a_holdout_of_everything_is_refused(scheduler: str) -> None:
    refused = idtool("fit", LEG, TRAIN, "--cluster", scheduler, "--holdout", 1)
    assert refused.code == 2
    assert refused.err == "error: --holdout: 1 is not a fraction; give a number from 0 to below 1\n"


def test_processes_on_this_machine_have_the_settings_and_this_one_has_its_own_again() -> None:
    names = list(_LOCAL_SETTINGS)
    before = [dask.config.get(name) for name in names]
    with open_cluster("local:1") as cluster:
        in_worker = dict(cluster.evaluate(dask.config.get, names))
    assert [in_worker[i] for i in range(len(names))] == list(_LOCAL_SETTINGS.values())
    assert [dask.config.get(name) for name in names] == before


def test_packages_that_are_not_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setitem(sys.modules, "upath", None)
    with pytest.raises(ConfigError, match=r"--cluster: needs Dask.*idtool\[cluster\]"), open_cluster("local:2"):
        pass
    with pytest.raises(package.LogError, match=r"is a URL, which needs packages.*idtool\[cluster\]"):
        package.Log("https://example.org/run.mcap")
