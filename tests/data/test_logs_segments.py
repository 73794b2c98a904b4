"""What `make_log` makes of times and missing values, and how much memory reading takes."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from sentences import sentences

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, make_log, read_log, write_log
from idtool.data.logs import log as log_module

Array = NDArray[np.float64]


def of(t: Array, **signals: Array) -> JointLog:
    signals = signals or {"q": np.zeros(len(t))}
    return make_log(Path("log"), t, ("hip",), {name: values[:, None] for name, values in signals.items()})


def bounds(log: JointLog) -> list[tuple[int, int]]:
    return [(part.start, part.stop) for part in log.segments]


@pytest.fixture(params=[1 << 15, 64, 7])
def block(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Blocks of several sizes, of which no segment may tell."""
    monkeypatch.setattr(log_module, "_BLOCK", request.param)


@pytest.mark.usefixtures("block")
class TestSegments:
    def test_gaps_and_backward_steps(self) -> None:
        t = np.arange(400) / 1000
        t[100:] += 0.004
        t[201:] += 0.0011
        t[300:] -= 0.5
        assert bounds(of(t)) == [(0, 100), (100, 201), (201, 300), (300, 400)]

    def test_late_stamps_are_no_gaps(self) -> None:
        t = np.arange(400) / 1000
        t[50:54] = 0.0531 + np.arange(4) / 10000  # came late, in a burst
        t[128] = t[127]
        t[256] -= 0.0009
        t[320] += 0.0008
        assert bounds(of(t)) == [(0, 400)]

    def test_a_late_last_stamp(self) -> None:
        t = np.arange(400) / 1000
        t[-3:] += 0.002
        assert bounds(of(t)) == [(0, 397), (397, 400)]

    def test_missing_values(self) -> None:
        t = np.arange(400) / 1000
        q, v = np.zeros(400), np.zeros(400)
        q[[0, 64, 65]] = np.nan
        v[[70, 399]] = np.inf
        t[200] = np.nan
        log = of(t, q=q, v=v, tau=np.full(400, np.nan))
        assert bounds(log) == [(1, 64), (66, 70), (71, 200), (201, 399)]
        assert sentences(log.notices) == ("6 samples have values that are not finite; they were left out",)
        assert list(log.signals) == ["q", "v"]

    def test_lone_samples_are_no_segments(self) -> None:
        q = np.zeros(20)
        q[1::2] = np.nan
        q[10:12] = 0
        assert bounds(of(np.arange(20.0), q=q)) == [(10, 13)]


def test_joints_that_lack_a_signal() -> None:
    q = np.zeros((10, 2))
    tau = np.column_stack([np.arange(10.0), np.full(10, np.nan)])
    log = make_log(Path("log"), np.arange(10.0), ("hip", "knee"), {"q": q, "tau": tau})
    assert bounds(log) == [(0, 10)]
    assert [log.has("tau", joint) for joint in ("hip", "knee", "toe")] == [True, False, False]
    assert not log.has("v", "hip")


@pytest.mark.parametrize(
    ("t", "q", "said"),
    [
        ([0, 1], [np.nan, np.nan], "no joint positions found"),
        ([0], [1], "has 1 sample; at least two are needed"),
        ([0, 0, 0], [1, 2, 3], "time does not advance"),
        ([2, 1, 0], [1, 2, 3], "time does not advance"),
        ([0, np.nan, np.inf], [1, 2, 3], "time does not advance"),
        ([0, 1, 2], [1, np.nan, 3], "no two consecutive samples are complete"),
    ],
)
def test_errors(t: list[float], q: list[float], said: str) -> None:
    with pytest.raises(LogError, match=said):
        of(np.array(t, dtype=float), q=np.array(q, dtype=float))


@pytest.mark.parametrize("ending", [".csv", ".mcap"])
def test_memory_beyond_the_result_does_not_grow(tmp_path: Path, ending: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("idtool.data.logs.sample_buffer._SPARE_BYTES", 1 << 16)
    monkeypatch.setattr("idtool.data.logs.table._BLOCK_BYTES", 1 << 18)
    monkeypatch.setattr("idtool.data.logs.mcap_records._LOOK_AHEAD_BYTES", 1 << 16)
    beyond = {}
    for count in (40_000, 160_000):
        path = tmp_path / f"{count}{ending}"
        write_log(path, of(np.arange(count) / 1024, q=np.arange(count) / 8, v=np.arange(count) / 4))
        tracemalloc.start()
        log = read_log(path)
        beyond[count] = tracemalloc.get_traced_memory()[1] - 3 * log.t.nbytes
        tracemalloc.stop()
    # Growing an array in place may be traced as a second copy of it: one of three.
    assert beyond[160_000] - beyond[40_000] < 0.4 * 120_000 * 3 * 8
