"""Files with bytes flipped, cut out and put in: a log or a LogError comes out, and nothing else."""

from __future__ import annotations

import tempfile
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from recordings import COMPRESSIONS, Proto, json_channel, proto_channel, ros2, states, write_mcap

from idtool.common.exceptions import LogError
from idtool.data.logs import JointLog, make_log, read_log, write_log

KINDS = ("loose", "chunk", "lz4", "zstd", "json", "protobuf", "unpacked", "csv", "quoted")


@cache
def valid(kind: str) -> bytes:
    """A small file that can be read."""
    items = states(6, ("hip", "knee"))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "log.csv")
        if kind in ("csv", "quoted"):
            values = np.random.default_rng(0).normal(size=(9, 2))
            write_log(path, make_log(path, np.arange(9) / 1000, ("hip", "knee"), {"q": values, "tau": values}))
            return path.read_bytes().replace(b",", b'","' if kind == "quoted" else b",")
        channel = {
            "json": lambda: json_channel(items),
            "protobuf": lambda: proto_channel(items, Proto()),
            "unpacked": lambda: proto_channel(items, Proto(packed=False)),
        }.get(kind, lambda: ros2(items))()
        compression = COMPRESSIONS.get(kind, COMPRESSIONS["none"])
        return write_mcap(path, channel, use_chunking=kind != "loose", compression=compression).read_bytes()


def survives(data: bytes) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "log")
        path.write_bytes(data)
        try:
            came: JointLog | LogError = read_log(path)
        except LogError as error:
            came = error
    if isinstance(came, LogError):
        assert str(came).startswith(f"{path}: ")
        assert str(came).isprintable()
        assert len(str(came)) < 1000
    else:
        assert all(array.shape == (len(came), len(came.joints)) for array in came.signals.values())


changes = st.lists(
    st.tuples(
        st.floats(0, 1, exclude_max=True),  # where
        st.sampled_from([0, 0, 0, 1, 8, 40]),  # how many bytes go
        st.one_of(
            st.binary(min_size=1, max_size=1),
            st.sampled_from([b"", b"\0" * 8, b"\xff" * 4, b"\xff" * 8, b",", b"\n", b'"', b"nan", b"[", b"\1"]),
        ),
    ),
    min_size=1,
    max_size=4,
)


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=150)
@given(changes=changes, end=st.none() | st.floats(0, 1))
def test_changed_files(kind: str, changes: list[tuple[float, int, bytes]], end: float | None) -> None:
    data = valid(kind)
    for where, gone, put in changes:
        at = int(where * len(data))
        data = data[:at] + put + data[at + (gone or len(put)) :]
    survives(data if end is None else data[: int(end * len(data))])


@pytest.mark.parametrize("kind", KINDS)
def test_unchanged_files(kind: str) -> None:
    survives(valid(kind))


@settings(max_examples=200)
@given(st.binary(max_size=200))
@example(b"\x89MCAP0\r\n")
@example(b"\x89MCAP0\r\n" * 2)
@example(b"\x89MCAP0\r\n" + b"\6" + b"\xff" * 8)
def test_any_bytes(data: bytes) -> None:
    survives(data)
    survives(b"\x89MCAP0\r\n" + data)
    survives(b"t,q_hip\n" + data)
