"""Which terms `idtool init` keeps, on benches whose verdicts are written out here."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from prescribed_motions import silent
from sentences import sentences, texts

from idtool.data.logs import JointLog, make_log
from idtool.setup import loaded_logs as seen
from idtool.setup.loaded_logs import first_samples
from idtool.setup.trial_evaluator import TrialScore
from idtool.setup.trials import TrialResults, TrialTerms, run_trials

Errors = Callable[[TrialTerms], Sequence[float]]  # mean square per joint, of the parts to fit or of the held-out ones

JOINTS = ["hip", "knee"]
ROTOR, OFFSET, DELAY = "rotor_inertia", "torque_offset", "time_delay"
TORQUE = 1000.0  # mean square of each joint's
BAND, DT = 40.0, 1e-3  # Hz, s


@dataclass
class TrialEvaluator:
    """Verdicts by the terms of a variant."""

    held_out: Errors
    train: Errors
    share: float
    judged: list[TrialTerms] = field(default_factory=list)

    @property
    def experiment(self) -> Any:
        signals = SimpleNamespace(log=SimpleNamespace(dt=DT), velocity_from_position=np.array([False, True]))
        equation = SimpleNamespace(joints=JOINTS)
        return SimpleNamespace(runs=[SimpleNamespace(signals=signals)], band_hz=BAND, notices=(), equation=equation)

    def torque(self) -> Any:
        return np.array([TORQUE, TORQUE])

    def score(self, terms: TrialTerms) -> TrialScore:
        self.judged.append(terms)
        values = {(effect, joint): 0.1 for effect in (ROTOR, OFFSET) for joint in JOINTS}
        train, held_out = (np.array(errors(terms), dtype=float) for errors in (self.train, self.held_out))
        return TrialScore(train, held_out, values, dict.fromkeys(values, self.share))


def tried(
    held_out: Errors, train: Errors | None = None, share: float = 10.0, delays: bool = False, offsets: bool = False
) -> tuple[TrialResults, TrialEvaluator]:
    """What is found where errors are these."""
    evaluator = TrialEvaluator(held_out, train or held_out, share)
    runner: Any = SimpleNamespace(
        joints=JOINTS, progress=silent, config=lambda terms: terms, evaluator=lambda terms: evaluator
    )
    effects = [*([] if delays else [ROTOR]), *([OFFSET] if offsets else [])]
    on_joints = [(effect, joint) for effect in effects for joint in JOINTS]
    return run_trials(runner, on_joints, [DELAY] if delays else []), evaluator


def joints(found: TrialResults, effect: str) -> tuple[str | None, ...]:
    """Joints with an effect that was kept."""
    return tuple(joint for kind, joint in found.values if kind == effect)


def delay(of: TrialResults | TrialTerms) -> float:
    """The delay that was kept, or that a variant has [s]."""
    if isinstance(of, TrialResults):
        return of.values.get((DELAY, None), 0.0)
    return dict(of.searched).get(DELAY, 0.0)


@pytest.mark.parametrize(("gain", "kept"), [(0.05, ("knee",)), (0.01, ())])
def test_a_term_stays_where_the_held_out_error_of_its_joint_needs_it(gain: float, kept: tuple[str, ...]) -> None:
    found, _ = tried(lambda terms: (1.0, (1 - gain) ** 2 if (ROTOR, "knee") in terms.on_joints else 1.0))
    assert joints(found, ROTOR) == kept
    assert [trial.kept for trial in found.trials] == [False, bool(kept)]


def test_terms_that_make_the_whole_worse_go() -> None:
    def errors(terms: TrialTerms) -> Sequence[float]:
        return (2.0, 0.005) if (ROTOR, "knee") in terms.on_joints else (1.0, 0.01)

    found, _ = tried(errors)
    assert not joints(found, ROTOR)
    assert not any(trial.kept for trial in found.trials)
    assert found.rms["found"] == found.rms["friction"]


def test_that_other_joints_lose_is_said() -> None:
    found, _ = tried(lambda terms: (1.1, 1.0) if (ROTOR, "knee") in terms.on_joints else (1.0, 9.0))
    assert joints(found, ROTOR) == ("knee",)
    assert "increase the held-out error of hip; the same bodies" in texts(found.notices)[0]


def test_what_is_too_small_to_be_missed_is_not_fitted_for() -> None:
    found, evaluator = tried(lambda terms: (1.0, 1.0), share=0.01)
    assert not joints(found, ROTOR)
    assert all(len(terms.on_joints) in (0, len(JOINTS)) for terms in evaluator.judged)
    _, evaluator = tried(lambda terms: (1.0, 1.0), share=1.0)
    assert not all(len(terms.on_joints) in (0, len(JOINTS)) for terms in evaluator.judged)


def test_nothing_is_kept_of_a_joint_whose_torque_stays_unexplained() -> None:
    def errors(terms: TrialTerms) -> Sequence[float]:
        return (
            1.0 - 0.5 * ((OFFSET, "hip") in terms.on_joints),
            TORQUE * (0.9 - 0.5 * ((OFFSET, "knee") in terms.on_joints)),
        )

    found, _ = tried(errors, offsets=True)
    assert joints(found, OFFSET) == ("hip",)
    assert any(
        "fraction of the held-out torque (rms) is unexplained: knee 95 %; check its sign and unit" in warning
        for warning in texts(found.notices)
    )


def delayed(at: float) -> Errors:
    """The error of a torque that is so late, parabolic [s]."""
    return lambda terms: (1 + 1e5 * (delay(terms) - at) ** 2,) * 2


@pytest.mark.parametrize("late", [0.09, -0.004, 0.002])
def test_a_delay_is_found(late: float) -> None:
    found, _ = tried(delayed(late), delays=True)
    assert delay(found) == pytest.approx(late, abs=1e-5)
    assert found.trials[0].kept


def test_a_delay_of_half_a_sample_is_none() -> None:
    """What is commanded is held until the next sample."""
    found, _ = tried(lambda terms: np.square(delayed(0.5 * DT)(terms)).tolist(), delays=True)
    assert found.trials[0].value == pytest.approx(0.5 * DT, abs=1e-4)
    assert delay(found) == 0.0


def test_a_delay_that_the_held_out_part_does_not_show_is_none() -> None:
    found, _ = tried(lambda terms: (1.0, 1.0), delayed(0.01), delays=True)
    assert found.trials[0].value == pytest.approx(0.01, abs=1e-4)
    assert delay(found) == 0.0


def test_a_delay_that_leaves_most_of_the_torque_unexplained_is_none() -> None:
    found, _ = tried(lambda terms: [0.6 * TORQUE * x for x in delayed(0.01)(terms)], delays=True)
    assert found.trials[0].value == pytest.approx(0.01, abs=1e-4)
    assert delay(found) == 0.0


@pytest.mark.parametrize(("at", "word"), [(0.3, "delays"), (-0.3, "advances")])
def test_a_delay_as_long_as_is_looked_for_is_none_and_said(at: float, word: str) -> None:
    found, _ = tried(lambda terms: (100 * abs(delay(terms) - at), 1.0), delays=True)
    assert (abs(found.trials[0].value), delay(found)) == (pytest.approx(0.1), 0.0)
    assert f"the best fit {word} the torque by 100 ms or more" in sentences(found.notices)[0]


def test_a_delay_stays_though_nothing_else_does() -> None:
    found, _ = tried(delayed(0.01), delays=True, offsets=True)
    assert (joints(found, OFFSET), delay(found)) == ((), pytest.approx(0.01, abs=1e-5))


def test_a_delay_stays_though_terms_that_make_the_whole_worse_go() -> None:
    def errors(terms: TrialTerms) -> Sequence[float]:
        late, knee = delayed(0.01)(terms)[0], (OFFSET, "knee") in terms.on_joints
        return late + knee, 0.01 * late / (1 + knee)

    found, _ = tried(errors, delays=True, offsets=True)
    assert (joints(found, OFFSET), delay(found)) == ((), pytest.approx(0.01, abs=1e-5))
    assert [trial.kept for trial in found.trials] == [True, False, False]


def segmented(*lengths: int) -> JointLog:
    """A log with a gap of a second between segments of so many samples."""
    t = np.concatenate([np.arange(n) * DT + 1000.0 * i for i, n in enumerate(lengths)])
    return make_log(__file__, t, ("hip",), {"q": np.sin(t)[:, None], "v": np.cos(t)[:, None]})  # type: ignore[arg-type]


def test_of_a_long_log_the_first_samples_are_kept_over_its_segments(monkeypatch: pytest.MonkeyPatch) -> None:
    log = segmented(60, 50, 40)
    assert [s.stop - s.start for s in log.segments] == [60, 50, 40]
    assert first_samples(log) is log
    monkeypatch.setattr(seen, "MAX_SAMPLES", 80)
    short = first_samples(log)
    assert [(s.start, s.stop) for s in short.segments] == [(0, 60), (60, 80)]
    assert len(short) == len(short.signals["v"]) == 80
    assert all(x.base is None for x in (short.t, *short.signals.values()))  # the rest can be freed
