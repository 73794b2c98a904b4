"""The table, the file and the page of benchmarks, and the measurement of a command."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bench
import bench_page
import growth
import numpy as np
import pytest
from bench_record import FILE, Bench, Machine
from child_cost import Cost, cost_of
from comparison import Comparison, compare, duration_text, from_times, number_text
from doc_pages import PAGES
from growth import Growth, Series, Task, log_slope
from lxml import etree
from rich.console import Console

MIB = 2**20
QUICK = from_times("a task", "a program 1.0", [(0.1, 1.0), (0.1, 3.0), (0.2, 4.0)], {"relative cost": 1e-9}, "A note.")
SLOW = from_times("another task", "a program 1.0", [(1.0, 0.4)])
GROWTH = Growth(
    quantity="joints",
    unit="joints",
    description="a chain",
    sizes=(3.0, 6.0, 12.0),
    costs=(Cost(1.0, 2.0, 100 * MIB), Cost(2.0, 8.0, 100 * MIB), Cost(4.0, 32.0, 200 * MIB)),
    load=0.5,
)
MACHINE = Machine("a processor", 2, 2**34, "Linux", "3.11.7", {"numpy": "2.4.6"})


def example() -> Bench:
    return Bench(
        date="2026-01-02",
        commands=["python benchmarks/bench.py"],
        version="0.1.0",
        commit="abc",
        machine=MACHINE,
        load=[0.1, 1.2],
        comparisons=[QUICK, SLOW],
        not_installed=["drake"],
        failures={"figaroh": "RuntimeError: no optimum"},
        growth=[GROWTH],
    )


def printed(record: Bench) -> str:
    console = Console(width=bench.TABLE_WIDTH, markup=False, highlight=False)
    with console.capture() as capture:
        console.print(bench.ratio_table(record))
    return capture.get()


def test_the_ratio_is_the_median_of_pairs_of_runs() -> None:
    assert (QUICK.ours, QUICK.theirs) == (0.1, 3.0)
    assert QUICK.ratio == pytest.approx(20)
    assert (QUICK.least_ratio, QUICK.greatest_ratio) == pytest.approx((10, 30))


def test_both_programs_take_turns() -> None:
    calls: list[str] = []
    compared = compare("a task", "a program", lambda: calls.append("ours"), lambda: calls.append("theirs"), 3)
    assert calls == ["ours", "theirs"] * 3
    assert compared.ratio > 0


@pytest.mark.parametrize(
    ("seconds", "text"), [(12.345, "12.3 s"), (1.0, "1 s"), (0.0123, "12.3 ms"), (4.56e-6, "4.56 µs")]
)
def test_durations_have_a_unit_of_their_size(seconds: float, text: str) -> None:
    assert duration_text(seconds) == text


@pytest.mark.parametrize(
    ("number", "text"), [(0.123, "0.12"), (3.456, "3.5"), (45.6, "46"), (99.6, "100"), (244, "240")]
)
def test_ratios_have_two_digits_and_no_exponent(number: float, text: str) -> None:
    assert number_text(number) == text


@pytest.mark.parametrize("exponent", [-1.0, 0.0, 0.5, 2.0])
def test_the_exponent_of_a_power_law_is_its_power(exponent: float) -> None:
    x = np.array([1.0, 7.0, 60.0])
    assert log_slope(x.tolist(), (3 * x**exponent).tolist()) == pytest.approx(exponent, abs=1e-9)


@pytest.mark.parametrize(("x", "y"), [([1.0], [2.0]), ([1.0, 1.0], [2.0, 3.0]), ([1.0, 2.0], [0.0, 3.0])])
def test_there_is_no_exponent_of_one_size_or_of_nothing(x: list[float], y: list[float]) -> None:
    with pytest.raises(ValueError, match="two sizes"):
        log_slope(x, y)


def test_the_exponents_of_a_growth() -> None:
    assert GROWTH.exponent("wall") == pytest.approx(1)
    assert GROWTH.exponent("cpu") == pytest.approx(2)
    assert GROWTH.exponent("memory") == pytest.approx(0.5)
    assert GROWTH.last_exponent("memory") == pytest.approx(1)


def test_the_cost_of_a_command_is_its_own() -> None:
    ballast = np.ones(40 * MIB)  # 320 MiB of this process are not the command's
    work = "import time; x = bytearray(64 * 2**20); t = time.process_time()\nwhile time.process_time() < t + 0.1: pass"
    cost = cost_of([sys.executable, "-c", work])
    assert ballast.nbytes == 320 * MIB
    assert 64 * MIB < cost.memory < 200 * MIB
    assert cost.cpu >= 0.1
    assert cost.wall >= 0.1


def test_a_command_that_fails_is_an_error_with_its_reason() -> None:
    with pytest.raises(RuntimeError, match="no such robot"):
        cost_of([sys.executable, "-c", "raise SystemExit('no such robot')"])


def test_a_series_is_measured(monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[float] = []

    def measure(task: Task, folder: Path) -> Cost:
        assert (folder / "robot.urdf").exists()
        assert len([*folder.glob("log_*.mcap")]) == task.logs
        runs.append(task.size)
        return Cost(len(runs), 2 * len(runs), MIB * len(runs))

    monkeypatch.setattr(growth, "measure", measure)
    tasks = tuple(Task(n, branches=1, length=2, minutes=0.002, logs=n) for n in (1, 2))
    measured = growth.measure_series(Series("logs", "logs", "a chain", tasks, repetitions=2), full=False)
    assert runs == [1, 1, 2, 1, 2]  # the first does not count
    assert measured.sizes == (1, 2)
    assert [cost.wall for cost in measured.costs] == [2, 3]  # the least
    assert [cost.memory for cost in measured.costs] == [4 * MIB, 5 * MIB]  # the largest


def test_a_fit_of_links_and_rotors_is_measured(tmp_path: Path) -> None:
    task = Task(4, branches=1, length=2, rotors=True, minutes=0.1)
    growth.write_files(task, tmp_path)
    cost = growth.measure(task, tmp_path)
    assert cost.memory > 50 * MIB
    assert len(json.loads((tmp_path / "out" / "report.json").read_text())["bodies"]) == task.size


def test_the_file_keeps_everything() -> None:
    text = example().as_json()
    assert Bench.from_json(text) == example()
    assert json.loads(text)["growth"][0]["exponents"]["cpu"]["all"] == pytest.approx(2)


def test_a_record_is_updated_by_a_later_one() -> None:
    better = replace(QUICK, ours=0.05)
    quicker = replace(GROWTH, load=0.0)
    later = replace(
        example(), commands=["again"], comparisons=[better], not_installed=[], failures={}, growth=[quicker]
    )
    updated = example().updated(later, ["figaroh", "joints"])
    assert updated.comparisons == [better, SLOW]
    assert updated.growth == [quicker]
    assert (updated.not_installed, updated.failures) == (["drake"], {})
    assert updated.commands == ["python benchmarks/bench.py", "again"]


def test_what_is_not_installed_or_failed_is_in_the_table() -> None:
    table = printed(example())
    assert re.search(r"a task .*\b100 ms .*\b3 s .*20 \(10 to 30\).*relative cost 1e-09", table)
    assert re.search(r"drake .*not installed", table)
    assert re.search(r"figaroh .*failed .*no optimum", table)


def test_a_missing_program_and_a_failure_do_not_stop_the_others(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail() -> list[Comparison]:
        raise ValueError("no optimum")

    def named(name: str, function: Callable[[], list[Comparison]], installed: bool = True) -> bench.Measurement:
        return bench.Measurement(name, name, function, lambda: installed)

    measurements = (named("failing", fail), named("missing", fail, installed=False), named("good", lambda: [QUICK]))
    monkeypatch.setattr(bench, "MEASUREMENTS", measurements)
    monkeypatch.setattr(growth, "SERIES", ())
    file = tmp_path / "bench.json"
    assert bench.main(["--out", str(file)]) == 1
    record = Bench.from_json(file.read_text())
    assert record.comparisons == [QUICK]
    assert record.not_installed == ["missing"]
    assert record.failures == {"failing": "ValueError: no optimum"}
    assert "missing" in capsys.readouterr().out
    assert bench.main(["good", "--out", str(file)]) == 0


def test_a_file_of_another_machine_is_not_updated(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "bench.json"
    file.write_text(example().as_json())
    with pytest.raises(SystemExit) as stopped:
        bench.main(["mcap", "--update", "--out", str(file)])
    assert stopped.value.code == 2
    assert "another machine or commit" in capsys.readouterr().err
    assert file.read_text() == example().as_json()


def test_an_unknown_name_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        bench.main(["dragon"])
    assert stopped.value.code == 2
    assert "dragon: is none of cvxpy" in capsys.readouterr().err


def test_the_page_shows_every_figure(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    file.write_text(example().as_json())
    bench_page.main(file, tmp_path)
    page = (tmp_path / "benchmarks.md").read_text()
    for shown in ("a processor, 2 cores, 16 GiB", "commit abc", "not installed", "20 (10 to 30)", "1. A note."):
        assert shown in page
    assert "| exponent | 1.00 | 2.00 | 0.50 |" in page
    bars = etree.fromstring((tmp_path / "images" / "bench_ratios.svg").read_text())
    curves = etree.fromstring((tmp_path / "images" / "bench_growth.svg").read_text())
    svg = "{http://www.w3.org/2000/svg}"
    assert len(bars.findall(f"{svg}rect")) == 1 + len(example().comparisons)
    assert len(curves.findall(f"{svg}polyline")) == 3  # wall time, CPU time, memory


def test_a_page_without_growth_or_comparisons(tmp_path: Path) -> None:
    file = tmp_path / "bench.json"
    file.write_text(replace(example(), comparisons=[], not_installed=[], growth=[]).as_json())
    bench_page.main(file, tmp_path)
    assert not [*(tmp_path / "images").iterdir()]


def test_the_committed_page_is_that_of_the_committed_file(tmp_path: Path) -> None:
    bench_page.main(FILE, tmp_path)
    for new in (tmp_path / "benchmarks.md", *(tmp_path / "images").iterdir()):
        committed = PAGES / new.relative_to(tmp_path)
        assert new.read_text() == committed.read_text(), "run python benchmarks/bench_page.py"
