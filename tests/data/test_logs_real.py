"""Logs of real robots, which are not part of the project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from paths import REAL
from sentences import sentences

from idtool.data.logs import read_log, write_log

pytestmark = pytest.mark.skipif(not REAL.is_dir(), reason=f"the real logs are not in {REAL}")

GO2 = [f"{leg}_{joint}_joint" for leg in ("FL", "FR", "RL", "RR") for joint in ("hip", "thigh", "calf")]


def test_panda() -> None:
    path = REAL / "panda" / "excitation.mcap"
    log = read_log(path)
    assert log.joints == tuple(f"panda_joint{i}" for i in range(1, 8))
    assert {name: array.shape for name, array in log.signals.items()} == dict.fromkeys(("q", "v", "tau"), (20544, 7))
    assert sentences(log.notices) == ()
    assert 1 / log.dt == pytest.approx(978, abs=3)
    assert len(log.segments) == 5
    gaps = [log.t[part.start] - log.t[part.start - 1] for part in log.segments[1:]]
    assert 0.008 < min(gaps) < max(gaps) < 0.009
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [m for i, (*_, m) in enumerate(reader.iter_decoded_messages()) if i % 100 == 0]
    for name, field in {"q": "position", "v": "velocity", "tau": "effort"}.items():
        np.testing.assert_array_equal(log.signals[name][::100], [getattr(m, field) for m in decoded])
    assert log.t[::100].tolist() == [m.header.stamp.sec + m.header.stamp.nanosec / 1e9 for m in decoded]


@pytest.mark.parametrize("run", [4, 5, 6, 7])
def test_go2(run: int) -> None:
    path = REAL / "go2" / f"chirp_{run}.csv"
    log = read_log(path)
    assert log.joints == tuple(GO2)
    assert list(log.signals) == ["q", "v", "qcmd"]
    assert log.dt == pytest.approx(0.005)
    assert len(log.segments) == 1
    assert sentences(log.notices) == ()
    table = np.genfromtxt(path, delimiter=",", names=True)
    np.testing.assert_array_equal(log.t, table["t"])
    for name, array in log.signals.items():
        np.testing.assert_array_equal(array, np.column_stack([table[f"{name}_{joint}"] for joint in GO2]))


@pytest.mark.parametrize("name", ["panda/excitation.mcap", "go2/chirp_4.csv"])
@pytest.mark.parametrize("ending", [".mcap", ".csv"])
def test_round_trip(tmp_path: Path, name: str, ending: str) -> None:
    log = read_log(REAL / name)
    write_log(tmp_path / f"log{ending}", log)
    read = read_log(tmp_path / f"log{ending}")
    assert read.joints == log.joints
    assert read.segments == log.segments
    np.testing.assert_allclose(read.t, log.t, rtol=0, atol=1e-9)
    for signal, array in log.signals.items():
        np.testing.assert_array_equal(read.signals[signal], array)
