"""What candidates explain, against least squares with their columns appended, a block left out in turn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from prescribed_motions import Stacked, prescribed_motion, silent, stacked, with_noise, with_torque
from spatial_arm import experiment, written

from idtool.data.column_cache import ColumnCache
from idtool.data.signals import Motion
from idtool.diagnosis import screen
from idtool.diagnosis.linearized_fit import LinearizedFit, linearize_fit
from idtool.diagnosis.model_selection import probe_target
from idtool.diagnosis.records import Candidate
from idtool.diagnosis.screen import ScreenedProbe, screen_probes, with_free_parameters
from idtool.diagnosis.summarize_data import summarize_data
from idtool.diagnosis.trial import with_effects
from idtool.dynamics.effects import NamedEffect, effect_from_entry, effect_types
from idtool.dynamics.effects.linearization import Linearization
from idtool.dynamics.effects.probe import Probe, ProbeColumns, joined_probe
from idtool.dynamics.linearized_model import LinearizedModel
from idtool.estimation.dataset import batch_cache
from idtool.estimation.dataset.batch_cache import BatchCache
from idtool.estimation.dataset.experiment import prepare
from idtool.robot.config import EffectEntry, parse_config
from idtool.robot.urdf.reading import read_robot

Array = NDArray[np.float64]

STIFFNESS, REST, LATE = 1.5, 0.3, 0.004  # N·m/rad, rad, s
CONFIG: dict[str, Any] = {
    "constraints": "none",
    "regularization": {"kind": "none"},
    "friction": {
        "turn": {"viscous": True, "coulomb": True, "offset": True},
        "lift": {"viscous": True, "coulomb": False, "offset": False},
        "roll": {"viscous": True, "coulomb": False, "offset": True},
    },
}


@pytest.fixture(scope="module")
def base(tmp_path_factory: pytest.TempPathFactory) -> LinearizedFit:
    """An arm with friction, a spring on its lift, and torque that comes late."""
    log = prescribed_motion(6.0)
    log = with_torque(log, 0, 1.2 * np.sign(log["v"][:, 0]) + 1.0 * log["v"][:, 0])
    log = with_torque(log, 1, STIFFNESS * (log["q"][:, 1] - REST) + 0.8 * log["v"][:, 1])
    log = with_torque(log, 2, 0.6 * log["v"][:, 2])
    late = [np.interp(log["t"] - LATE, log["t"], row) for row in log["tau"].T]
    log = with_noise({**log, "tau": np.array(late).T}, 0.05)
    tried = experiment(*written(tmp_path_factory.mktemp("arm"), log), fitted=True, **CONFIG)
    return linearize_fit(tried, silent)


@pytest.fixture(scope="module")
def rows(base: LinearizedFit) -> Stacked:
    """Its rows."""
    return stacked(base.experiment, base.noise, base.block_length)


def appended(base: LinearizedFit, probe: Probe) -> list[Array]:
    """A probe's columns beside `rows`."""
    found: list[Array] = []
    for batch in (batch for run in base.experiment.runs for batch in run.signals.batches(run.train)):
        present = LinearizedModel(base.experiment.equation, base.theta, batch.motion)
        made, kept = probe.columns(present.true_motion, present), base.experiment.equation.clean_samples(batch)
        for j, keep in enumerate(kept):
            own = batch.filter(made.get(j, np.zeros((probe.coefficient_count, len(batch.motion.t)))))
            found.append(own[:, keep] / base.noise[j])
    return list(np.concatenate(found, axis=1))


def made(columns: ProbeColumns, size: int = 1, **options: Any) -> Probe:
    """A probe that makes an entry of whatever it finds."""
    return Probe("any", None, None, columns, size, lambda c, information: EffectEntry(effect="any"), **options)


def bump(motion: Motion, present: Linearization) -> Mapping[int, Array]:
    """Something that no model has, on two joints."""
    x = np.exp(-20 * (motion.q[1] - 0.1) ** 2)
    return {0: 0.3 * x[None], 2: np.cos(motion.t)[None]}


def waves(motion: Motion, present: Linearization) -> Mapping[int, Array]:
    """Four columns."""
    return {1: np.sin(np.outer([3, 5, 7, 9], motion.q[1]))}


def of(base: LinearizedFit, effect: str, joint: int | None) -> Probe:
    """An effect's first probe, on a joint or on all."""
    name = None if joint is None else base.experiment.equation.joints[joint]
    return next(probe for probe in effect_types()[effect].probes(summarize_data(base)) if probe.joint == name)


def probes(base: LinearizedFit) -> list[Probe]:
    """Of all sizes and on several joints, some with shape values."""
    found = [made(bump), of(base, "parallel_spring", 1), made(waves, 4), of(base, "time_delay", None)]
    return [*found, of(base, "time_delay", 2), of(base, "stribeck_friction", 0), of(base, "parallel_spring", 0)]


def free(probe: Probe) -> Probe:
    """The same without bounds."""
    return replace(probe, lower=(), upper=())


def assert_same(found: ScreenedProbe, expected: ScreenedProbe, rtol: float = 1e-9) -> None:
    """The same probe, coefficients and gains."""
    size = np.abs(expected.gains).max() + 1e-9
    np.testing.assert_allclose(found.c, expected.c, rtol=rtol, atol=1e-12)
    np.testing.assert_allclose(found.gains, expected.gains, rtol=0, atol=rtol * size)
    np.testing.assert_allclose(found.covariance, expected.covariance, rtol=rtol, atol=1e-15)
    np.testing.assert_allclose(found.information, expected.information, rtol=rtol, atol=rtol)


@pytest.mark.parametrize("index", range(7))
def test_a_probe_is_least_squares_with_its_columns(base: LinearizedFit, rows: Stacked, index: int) -> None:
    """Gains and coefficients, their jackknife covariance, and the information that the model's columns leave."""
    probe = free(probes(base)[index])
    (found,) = screen_probes(base, [probe], silent)
    columns = appended(base, probe)
    squares, c = rows.left(*columns)
    gains = rows.left()[0] - squares
    np.testing.assert_allclose(found.gains, gains, rtol=0, atol=2e-3 * np.abs(gains).max())
    every = Stacked(
        np.vstack([rows.Y, np.zeros_like(rows.Y[:1])]), np.append(rows.tau, 0), np.append(rows.block * 0 + 1, 0)
    )
    whole = every.left(*(np.append(column, 0.0) for column in columns))[1][0]
    np.testing.assert_allclose(found.c, whole, atol=2e-3 * np.abs(whole).max())
    folds = len(c)
    jackknife = (folds - 1) ** 2 / folds * np.atleast_2d(np.cov(c.T))
    np.testing.assert_allclose(found.covariance, jackknife, atol=5e-3 * np.abs(jackknife).max())
    size = np.linalg.norm(rows.Y, axis=0)
    Y, C = rows.Y[:, size > 0] / size[size > 0], np.column_stack(columns)
    beside = C - Y @ np.linalg.lstsq(Y, C, rcond=1e-9)[0]
    np.testing.assert_allclose(found.information, C.T @ beside, rtol=1e-3, atol=1e-3 * np.abs(C.T @ beside).max())


def test_several_logs_are_one_row_of_blocks(tmp_path: Path) -> None:
    logs = [with_noise(prescribed_motion(seconds, seed=seed), 0.3, seed) for seed, seconds in enumerate((2.3, 4.0))]
    paths = [written(tmp_path / str(i), log) for i, log in enumerate(logs)]
    config = parse_config({**CONFIG, "friction": {"viscous": False, "coulomb": False}}, "")
    both = linearize_fit(prepare(read_robot(paths[0][0]), config, [csv for _, csv in paths], holdout=0), silent)
    rows = stacked(both.experiment, both.noise, both.block_length)
    (found,) = screen_probes(both, [made(bump)], silent)
    gains = rows.left()[0] - rows.left(*appended(both, made(bump)))[0]
    assert len(gains) == both.block_count
    np.testing.assert_allclose(found.gains, gains, rtol=0, atol=2e-3 * np.abs(gains).max())


def test_what_is_there_is_found_to_its_size(base: LinearizedFit) -> None:
    """The spring with what else is there; the delay, most of what is left."""
    spring, late = screen_probes(base, [of(base, "parallel_spring", 1), of(base, "time_delay", None)], silent)
    assert spring.is_possible
    assert late.is_possible
    assert spring.c[0] == pytest.approx(STIFFNESS, abs=4 * np.sqrt(spring.covariance[0, 0]))
    assert late.c[0] == pytest.approx(LATE, abs=4 * np.sqrt(late.covariance[0, 0]))
    assert late.entry is not None
    assert late.entry.parameters["delay"] == pytest.approx(late.c[0])
    for found in (spring, late):
        assert abs(found.c[0]) > 4 * np.sqrt(found.covariance[0, 0])
        assert found.gain > 2 * found.standard_error > 0
    nothing = screen_probes(base, [made(bump)], silent)[0]
    assert nothing.gain < 0.05 * late.gain


def viscous(motion: Motion, present: Linearization) -> Mapping[int, Array]:
    """What the model has."""
    return {2: 3 * motion.v[2][None]}


def twice(motion: Motion, present: Linearization) -> Mapping[int, Array]:
    """A column that is new, one that is its copy, one that the model has, one that is nothing."""
    new = np.cos(3 * motion.q[1])
    return {1: np.stack([new, -2 * new, motion.v[1], 0 * new])}


def test_what_the_model_can_make_itself_says_nothing(base: LinearizedFit) -> None:
    found = screen_probes(
        base, [made(viscous), made(twice, 4), made(lambda m, p: {1: np.cos(3 * m.q[1])[None]})], silent
    )
    said, several, alone = found
    np.testing.assert_array_equal(said.c, 0)
    np.testing.assert_array_equal(said.gains, 0)
    np.testing.assert_allclose(several.gains, alone.gains, atol=2e-3 * np.abs(alone.gains).max())
    assert several.c[0] - 2 * several.c[1] == pytest.approx(alone.c[0], rel=1e-3)
    assert several.c[3] == 0


def test_a_column_that_the_model_can_reproduce_has_no_coefficient_beside_another_one(base: LinearizedFit) -> None:
    (both,) = screen_probes(
        base, [joined_probe(made(viscous), made(lambda m, p: {1: np.cos(3 * m.q[1])[None]}))], silent
    )
    assert both.c[0] == both.covariance[0, 0] == 0
    assert both.c[1] != 0


def test_a_fit_on_the_rows_of_another_is_screened_on_these(base: LinearizedFit) -> None:
    """Coulomb friction on a joint, whose column is undefined at reversals; the other model has rows there."""
    friction = EffectEntry(effect="coulomb_friction", joint="lift", parameters={"coulomb": 0.1})
    tried = with_effects(base.experiment, [friction], base.theta)
    on_its_rows = linearize_fit(tried, silent, base)
    assert (on_its_rows.row_counts.sum(axis=0) > linearize_fit(tried, silent).row_counts.sum(axis=0)).any()
    (of_the_model,) = screen_probes(on_its_rows, [made(lambda m, p: {1: m.v[1][None]})], silent)
    (new,) = screen_probes(on_its_rows, [made(bump)], silent)
    assert abs(of_the_model.information[0, 0]) < 1e-4 * abs(new.information[0, 0])
    np.testing.assert_array_equal(of_the_model.gains, 0)


def test_what_physics_forbids_explains_nothing(base: LinearizedFit) -> None:
    """A spring with its sign turned round would have the same gain."""
    probe = of(base, "parallel_spring", 1)
    turned = replace(probe, columns=lambda m, p: {j: -x for j, x in probe.columns(m, p).items()})
    right, wrong, free_of_bounds = screen_probes(base, [probe, turned, free(turned)], silent)
    np.testing.assert_allclose(wrong.c, -right.c, rtol=1e-6)
    assert right.is_possible
    assert not wrong.is_possible
    np.testing.assert_array_equal(wrong.gains, 0)
    np.testing.assert_allclose(free_of_bounds.gains, right.gains, rtol=1e-6, atol=1e-6)
    assert right.gain > 100
    assert not replace(
        free_of_bounds, probe=replace(turned, lower=(), to_entry=lambda c, information: None)
    ).is_possible


def test_what_acts_in_its_own_time_is_fitted_to_that(base: LinearizedFit) -> None:
    """A column in one block alone: other blocks know nothing of it, and only one that is local is believed."""
    begin, end = (base.block_length * k * 6e-3 + 0.1 for k in (4, 5))

    def window(motion: Motion, present: Linearization) -> Mapping[int, Array]:
        return {1: ((motion.t > begin) & (motion.t < end) & (motion.q[1] < 9)).astype(float)[None]}

    apart, together = screen_probes(base, [made(window), made(window, is_local=True)], silent)
    np.testing.assert_allclose(apart.c, together.c)
    assert together.gain > max(apart.gain, 0) + 1


@pytest.mark.parametrize(("name", "value"), [("_MAX_NUMBERS", 1.0), ("_MAX_NUMBERS", 3000.0), ("_MAX_COLUMNS", 1)])
def test_however_many_at_once(base: LinearizedFit, monkeypatch: pytest.MonkeyPatch, name: str, value: float) -> None:
    every = probes(base)
    expected = screen_probes(base, every, silent)
    calls: list[Sequence[Probe]] = []
    inner = screen._sums_by_probe

    def counted(*arguments: Any) -> Any:
        calls.append(arguments[1])
        return inner(*arguments)

    monkeypatch.setattr(screen, "_sums_by_probe", counted)
    monkeypatch.setattr(screen, name, value)
    found = screen_probes(base, every, silent)
    assert [one.probe for one in found] == every
    assert sum(len(some) for some in calls) == len(every)
    assert len(calls) > 1 or name == "_MAX_COLUMNS"
    for one, other in zip(found, expected, strict=True):
        assert_same(one, other, 1e-6)


@pytest.mark.parametrize("effect", list(effect_types()))
def test_a_probe_and_its_record_name_the_same_target(effect: str) -> None:
    """Candidates are compared by it, so that a diagnosis lists each one once."""
    probe: Any = SimpleNamespace(effect=effect, joint=None, link=None)
    assert probe_target(probe) == (effect, Candidate(effect, None, None, 0.1, 0.01, 1).target)


def test_columns_that_are_kept_for_other_models_change_no_result(base: LinearizedFit) -> None:
    cached = replace(base.experiment, cache=BatchCache())
    late = EffectEntry(effect="time_delay", parameters={"delay": LATE})
    first = linearize_fit(cached, silent)
    for entries in ([], [late], [late], []):  # the second time, all columns are there
        kept = linearize_fit(with_effects(cached, entries), silent, first)
        anew = linearize_fit(with_effects(base.experiment, entries), silent, base)
        np.testing.assert_allclose(kept.estimate.theta, anew.estimate.theta, rtol=1e-9, atol=1e-12)
        tried = probes(base)
        for a, b in zip(screen_probes(kept, tried, silent), screen_probes(anew, tried, silent), strict=True):
            assert_same(a, b, rtol=1e-6)


@pytest.mark.parametrize(("batches", "columns"), [(1, 1 << 30), (1 << 30, 1), (1 << 30, 1 << 20), (1 << 30, 1 << 30)])
def test_little_memory_changes_no_result(
    base: LinearizedFit, monkeypatch: pytest.MonkeyPatch, batches: int, columns: int
) -> None:
    """None for batches, none for columns, or for a few columns."""
    monkeypatch.setattr(batch_cache, "ColumnCache", partial(ColumnCache, max_bytes=columns))
    small = replace(base.experiment, cache=BatchCache(max_bytes=batches))
    for _ in range(2):  # the second time, what there was memory for is there
        fitted = linearize_fit(small, silent)
        np.testing.assert_allclose(fitted.theta, base.theta, rtol=1e-12)
        kept = screen_probes(fitted, probes(base), silent)
        for a, b in zip(kept, screen_probes(base, probes(base), silent), strict=True):
            assert_same(a, b)


def test_batches_for_which_there_is_no_memory_are_read_again(base: LinearizedFit) -> None:
    """Of two parts of a log, one fits; one that is left in the middle is read anew."""
    run = base.experiment.runs[0]
    (part,) = run.train
    middle = part.start + 2 * (part.stop - part.start) // 3
    large, small = slice(part.start, middle), slice(middle, part.stop)
    cache = BatchCache(max_bytes=8 * 5 * (middle - part.start) * len(base.experiment.equation.joints))
    first_batch = cache.batches(run.signals, [large])[0]
    first = [list(cache.batches(run.signals, [part])) for part in (large, small)]
    again = [list(cache.batches(run.signals, [part])) for part in (large, small)]
    assert first[0][0] is first_batch
    assert [a is b for a, b in zip(first[0], again[0], strict=True)] == [True] * len(first[0])
    assert not any(a is b for a, b in zip(first[1], again[1], strict=True))
    for a, b in zip(first[1], again[1], strict=True):
        np.testing.assert_array_equal(a.motion.q, b.motion.q)


def test_a_corrected_motion_is_never_that_of_another_motion(base: LinearizedFit) -> None:
    """A batch that is left in the middle of a log is freed, and its place in memory goes to another one."""
    late = EffectEntry(effect="time_delay", parameters={"delay": LATE})
    equation = with_effects(base.experiment, [late]).equation
    run = base.experiment.runs[0]
    for k in range(50):
        batch = BatchCache().batches(run.signals, run.train)[0]
        motion = replace(batch.motion, tau=batch.motion.tau + k)
        del batch
        expected = replace(motion, kept_columns=None)
        np.testing.assert_array_equal(equation.true_motion(motion).tau, equation.true_motion(expected).tau)
        del motion, expected


@pytest.mark.parametrize("effect", sorted(effect_types()))
def test_columns_that_are_kept_depend_on_the_measured_motion_alone(base: LinearizedFit, effect: str) -> None:
    batch = base.experiment.batches(base.experiment.runs[0], held_out=False)[0]
    other = replace(batch.motion, tau=-2 * batch.motion.tau, logged_tau=3 * batch.motion.logged_tau)
    for probe in effect_types()[effect].probes(summarize_data(base)):
        if probe.column_key is None:
            continue
        entry = probe.to_entry(np.ones(probe.coefficient_count), np.eye(probe.coefficient_count))
        assert entry is not None
        built = effect_from_entry(entry, base.experiment.model)
        assert built.column_key == probe.column_key
        for a, b in zip(columns_along(built, batch.motion), columns_along(built, other), strict=True):
            np.testing.assert_array_equal(a, b)


def columns_along(effect: NamedEffect, motion: Motion) -> list[Array]:
    """An effect's columns along a motion, per joint."""
    out = [np.zeros((len(active), len(motion.t))) for active in effect.active]
    effect.columns(motion, out)
    return out


def test_beside_free_parameters_a_probe_has_the_information_that_it_has_beside_their_columns(
    base: LinearizedFit,
) -> None:
    probe = made(bump)
    (beside,) = screen_probes(with_free_parameters(base, made(waves, 4), silent), [probe], silent)
    (joined,) = screen_probes(base, [joined_probe(probe, made(waves, 4))], silent)
    np.testing.assert_allclose(beside.information, joined.marginal_information(slice(0, 1)), rtol=1e-9)


def test_probes_that_are_screened_in_pairs_explain_what_their_columns_do_together(base: LinearizedFit) -> None:
    alone = probes(base)
    pairs = [(0, 1), (0, 2), (2, 4), (6, 1), (3, 5)]
    joined = [joined_probe(alone[i], alone[j]) for i, j in pairs]
    screened_in_pairs = screen.screen_pairs(base, alone, pairs, silent)
    for found, expected in zip(screened_in_pairs, screen_probes(base, joined, silent), strict=True):
        assert_same(found, expected)


def test_parameters_that_the_model_has_are_free_already(base: LinearizedFit) -> None:
    """The third joint's damping, beside which nothing changes."""
    damping = made(lambda motion, present: {2: motion.v[2][None]})
    (found,) = screen_probes(with_free_parameters(base, damping, silent), [made(bump)], silent)
    (expected,) = screen_probes(base, [made(bump)], silent)
    assert_same(found, expected)


def test_a_candidate_that_free_parameters_imitate_explains_nothing(base: LinearizedFit) -> None:
    spring = of(base, "parallel_spring", 1)
    (alone,) = screen_probes(base, [spring], silent)
    (beside_itself,) = screen_probes(with_free_parameters(base, spring, silent), [spring], silent)
    assert abs(beside_itself.gain) < 0.05 * alone.gain


def test_what_free_parameters_explain_is_not_explained_by_what_resembles_it(base: LinearizedFit) -> None:
    """A candidate that is 0.9 of the delay and 0.4 of something that is not there."""
    delay = of(base, "time_delay", None)

    def mixture(motion: Motion, present: Linearization) -> Mapping[int, Array]:
        other = bump(motion, present)
        columns = delay.columns(motion, present)
        size = {j: np.linalg.norm(columns[j]) / np.linalg.norm(other[j]) for j in other}
        return {j: 0.9 * columns[j] + 0.4 * size[j] * other[j] for j in other}

    (alone,) = screen_probes(base, [made(mixture)], silent)
    (beside,) = screen_probes(with_free_parameters(base, delay, silent), [made(mixture)], silent)
    assert alone.gain > 100
    assert abs(beside.gain) < 0.05 * alone.gain


def test_a_free_parameter_of_one_block_changes_nothing_elsewhere(base: LinearizedFit) -> None:
    """Left out with its block, it is undetermined."""
    first = base.block_length * base.experiment.runs[0].signals.low_pass.stride * base.experiment.runs[0].signals.log.dt
    push = made(lambda motion, present: {0: np.sin(20 * motion.t)[None] * (motion.t[None] < 0.9 * first)})
    spring = of(base, "parallel_spring", 1)
    (alone,) = screen_probes(base, [spring], silent)
    (beside,) = screen_probes(with_free_parameters(base, push, silent), [spring], silent)
    assert beside.gain == pytest.approx(alone.gain, rel=0.2)
