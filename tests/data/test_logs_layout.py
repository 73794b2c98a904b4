"""Binary messages are decoded together, by the layout of one: found again in the next buffer, and never mistaken."""

from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from idtool.common.arrays import indices_by_value, items_at
from idtool.common.exceptions import LogError
from idtool.data.logs import stored_arrays
from idtool.data.logs.mcap_records import HEAD, MAGIC, MESSAGE, RECORD, McapRecords
from idtool.data.logs.payloads.base import PayloadError
from idtool.data.logs.payloads.cdr import encode, layout_of
from idtool.data.logs.payloads.layout import Layout, LayoutDecoder
from idtool.data.logs.sample_buffer import Samples
from idtool.data.logs.stored_arrays import StoredRows, evaluate_blocks

RNG = np.random.default_rng(0)


def joint_states(count: int, joints: tuple[str, ...], first: int = 0) -> list[bytes]:
    """Messages whose q counts up."""
    q = np.arange(first, first + count)[:, None] + np.linspace(0, 0.5, len(joints))
    stamps = (np.arange(first, first + count) + 1) * 10**6
    return [message.tobytes() for message in encode(stamps, joints, {"q": q, "tau": -q})]


def buffer_of(messages: list[bytes], gaps: list[int]) -> tuple[bytes, NDArray[np.intp], NDArray[np.intp]]:
    """A buffer with so many bytes before each message; starts and lengths."""
    buffer, starts = b"", []
    for message, gap in zip(messages, gaps, strict=True):
        buffer += b"\xaa" * gap
        starts.append(len(buffer))
        buffer += message
    return buffer + b"\xaa", np.array(starts, dtype=np.intp), np.array([len(m) for m in messages], dtype=np.intp)


def decoded(samples: list[Samples]) -> dict[int, tuple[tuple[str, ...], float, float]]:
    """Joints, time and first q of each message, by its index."""
    found = {}
    for piece in samples:
        for i, t, q in zip(piece.index, piece.t, piece.signals["q"][:, 0], strict=True):
            found[int(i)] = (piece.joints, float(t), float(q))
    return found


@pytest.mark.parametrize("spacing", ["equal", "unequal"])
def test_layouts_may_change_within_a_buffer_and_between_two(spacing: str) -> None:
    """Names of the same length, other joints, no joints, an empty message; one decoder for all."""
    decode = LayoutDecoder(layout_of)
    kinds = [("hip", "knee"), ("hop", "knee"), ("hip", "knee", "foot"), ("hip", "knee")]
    for first in (0, 100):
        messages, expected = [], {}
        for joints in kinds:
            for message in joint_states(5, joints, first):
                expected[len(messages)] = joints
                messages.append(message)
        messages.insert(7, b"")
        expected = {i + (i >= 7): joints for i, joints in expected.items()}
        gaps = [31] * len(messages) if spacing == "equal" else RNG.integers(0, 50, len(messages)).tolist()
        found = decoded(decode(*buffer_of(messages, gaps)))
        assert {i: joints for i, (joints, _, _) in found.items()} == expected
        for i, (_, t, q) in found.items():
            k = first + (i - (i > 7)) % 5
            assert (t, q) == (pytest.approx((k + 1) * 1e-3, abs=1e-12), k)


def test_a_damaged_message_is_named_by_its_index() -> None:
    messages = joint_states(6, ("hip", "knee"))
    messages[4] = b"\xff" * len(messages[4])
    with pytest.raises(PayloadError) as raised:
        LayoutDecoder(layout_of)(*buffer_of(messages, [31] * 6))
    assert raised.value.index == 4


def test_messages_without_a_layout_are_told_and_asked_about_once() -> None:
    """However they are mixed with others."""
    asked = []

    def even_only(message: bytes) -> Layout | None:
        asked.append(message)
        k = round(1e-6 * struct.unpack_from("<I", message, 8)[0]) - 1
        return None if k % 2 else layout_of(message)

    decoder = LayoutDecoder(even_only)
    messages = joint_states(400, ("hip", "knee"))
    odd = [message[:-8] + b"\0" * 4 + message[-4:] for message in messages[1::2]]
    mixed = [*messages[:1], *messages[2::2], *[b"\1\1" + message[2:] for message in odd]]
    samples, without = decoder.decode(*buffer_of(mixed, [31] * 400))
    assert without == list(range(200, 400))
    assert len(decoded(samples)) == 200
    assert len(asked) == 201


def test_values_side_by_side_and_one_by_one_are_the_same() -> None:
    messages = np.array([np.frombuffer(message, np.uint8) for message in joint_states(7, ("hip", "knee"))])
    layout = layout_of(messages[0].tobytes())
    offset, dtype = layout.fields["q"]
    one_by_one = Layout(layout.joints, layout.mask, {"q": (np.array([offset + 8, offset]), dtype)}, layout.stamp)
    for view in (messages, np.repeat(messages, 2, axis=0)[::2]):
        np.testing.assert_array_equal(one_by_one.values(view, "q"), layout.values(view, "q")[:, ::-1])


@pytest.mark.parametrize("offsets", [[], [3], [3, 3 + 9], [0, 5, 10, 15], [0, 5, 11]])
def test_items_at_offsets(offsets: list[int]) -> None:
    buffer = bytes(range(60))
    items = items_at(buffer, np.array(offsets, dtype=np.intp), np.dtype("<u4"))
    assert items.tolist() == [struct.unpack_from("<I", buffer, offset)[0] for offset in offsets]


@pytest.mark.parametrize("x", [[], [4], [4, 4, 4], [4, 1, 4, 9, 1]])
def test_indices_by_value(x: list[int]) -> None:
    found = {value: index.tolist() for value, index in indices_by_value(np.array(x, dtype=np.intp))}
    assert found == {value: [i for i, other in enumerate(x) if other == value] for value in sorted(set(x))}
    assert list(found) == sorted(found)


def mcap_of(path: Path, messages: NDArray[Any]) -> Path:
    """A file of messages with nothing but their heads, one after the other."""
    path.write_bytes(MAGIC + messages.tobytes())
    return path


def test_messages_of_many_channels_take_little_memory(tmp_path: Path) -> None:
    """Each of its own, which no definition names: a small compressed file could hold many."""
    messages = np.zeros(80_000, HEAD)
    messages["opcode"], messages["length"] = MESSAGE, HEAD.itemsize - RECORD.size
    messages["channel"] = np.arange(len(messages)) % 2**16
    path = mcap_of(tmp_path / "many.mcap", messages)
    count = 0
    with path.open("rb") as file:
        records = McapRecords(path, file, path.stat().st_size)
        tracemalloc.start()
        for batch in records:
            count += len(batch.messages)
            assert sum(len(own.index) for own in batch.channels.values()) == len(batch.messages)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    assert count == len(messages)
    assert peak < 40e6


def test_damage_in_the_middle_of_a_run_is_found(tmp_path: Path) -> None:
    messages = np.zeros(100, HEAD)
    messages["opcode"], messages["length"] = MESSAGE, HEAD.itemsize - RECORD.size
    messages["length"][50] = 3
    path = mcap_of(tmp_path / "damaged.mcap", messages)
    with path.open("rb") as file, pytest.raises(LogError, match="is damaged near byte"):
        list(McapRecords(path, file, path.stat().st_size))


@pytest.mark.parametrize("processes", [1, 2, 7])
def test_blocks_in_threads_see_every_row_once(processes: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """And those of all threads together are no more than of one."""
    monkeypatch.setattr(stored_arrays, "process_count", lambda: processes)
    monkeypatch.setattr("idtool.common.threads.process_count", lambda: processes)
    rows = StoredRows(Path("log"), 40)
    x = RNG.normal(size=(30_000, 40))
    rows.append(x)
    stored = rows.array()
    sums = evaluate_blocks(lambda part: (part.stop - part.start, stored[part].sum(axis=0)), [stored], len(stored))
    assert max(count for count, _ in sums) * processes <= stored_arrays.BLOCK_ROWS
    np.testing.assert_allclose(np.sum([total for _, total in sums], axis=0), x.sum(axis=0), rtol=1e-9, atol=1e-9)
