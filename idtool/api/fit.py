"""`fit`: identify a model from logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from idtool.api.data import Logs, call, changed, experiment_of
from idtool.api.identified import Body, Friction, Rms, body_of
from idtool.api.model import IDENTIFIED, SETTINGS, Model, Source, identified_text
from idtool.api.records import Progress, ReadOnly, Saved, figure, frozen, notes, silent, table
from idtool.common.outputs import as_json, as_yaml
from idtool.diagnosis.faults import faults
from idtool.diagnosis.maps import residual_maps
from idtool.estimation.dataset.experiment import Experiment
from idtool.estimation.fit import Fit
from idtool.estimation.fit import fit as run_fit
from idtool.estimation.identification import Method
from idtool.reporting.report import fit_report, model_config

if TYPE_CHECKING:
    from plotly.graph_objects import Figure

    from idtool.api.records import Recorded
    from idtool.reporting.pages.fit import Maps


_SERIOUS = ("wrong_unit", "wrong_sign", "wrong_joint_order", "clipped", "wrapped_position")  # what no model mends


@dataclass(frozen=True, eq=False, repr=False)
class FitResult(Saved):
    """An identified model, and how far to trust it.

    Attributes
    ----------
    joints
        Joints, in the order of the model.
    rms, rms_raw
        Torque errors in the filter's band, and against the torque as logged.
    bodies
        Links and rotors, by name.
    friction
        By joint.
    simulation
        How far the model run forwards is from the measured motion, as ``simulation`` of report.json; None: not run.
    warnings
        What a user should know, a plain sentence each.
    """

    joints: tuple[str, ...]
    rms: Rms
    rms_raw: Rms
    bodies: ReadOnly[Body]
    friction: ReadOnly[Friction]
    simulation: ReadOnly[Any] | None
    warnings: tuple[str, ...]
    _fit: Fit
    _maps: Maps | None
    _report: Mapping[str, Any]
    _made_by: str

    @cached_property
    def model(self) -> Model:
        """The identified model, for `idtool.validate`, `idtool.simulate` and `idtool.diagnose`."""
        return Model.identified(self._fit)

    def _files(self, folder: Path, made_by: str) -> dict[str, str | bytes]:
        from idtool.reporting.pages import fit_page

        urdf = self._fit.experiment.model.robot.path.name
        header = f"Identified by idtool from {urdf}; with identified.urdf it is the identified model."
        return {
            IDENTIFIED: identified_text(self._fit, folder),
            SETTINGS: as_yaml(model_config(self._fit), header),
            "report.json": as_json(self._report),
            "report.html": fit_page(self._fit, dict(self._report), made_by, self._maps),
        }

    def _recorded(self) -> Recorded:
        from idtool.api.recording import of_fit

        return self._fit.experiment.model, of_fit(self._fit), "identified"

    def plot(self, log: int = 0) -> Figure:
        """Measured and predicted torque and the residual of every joint, on the held-out data where there are any.

        Parameters
        ----------
        log
            Which of the logs.

        Raises
        ------
        IndexError
            If there are not so many.
        """
        from idtool.api.plots import torque_figure
        from idtool.reporting.pages import curves

        evaluation = self._fit.train if self.rms.validation is None else self._fit.validation
        return torque_figure(curves(evaluation, "identified", self._report["units"]), log)

    def __repr__(self) -> str:
        units = " or ".join(dict.fromkeys(self._report["units"].values()))
        own, prior = self.rms.validation, self.rms.prior_validation
        data = "what was fitted" if own is None else "held-out data"
        head = ["joint", "identified", *(["given"] if prior else []), "viscous", "coulomb"]
        rows = []
        for name in (*self.joints, "overall"):
            terms = self.friction.get(name)
            errors = [(own or self.rms.train)[name], *([prior[name]] if prior else [])]
            rows.append(
                [name, *map(figure, errors), *map(figure, (terms.viscous, terms.coulomb) if terms else (None,) * 2)]
            )
        masses = ", ".join(f"{body.name} {body.mass:.4g}" for body in list(self.bodies.values())[:6])
        more = f" and {len(self.bodies) - 6} more" if len(self.bodies) > 6 else ""
        urdf, band = Path(self._report["urdf"]).name, f"below {self._report['band_hz']:g} Hz"
        return "\n".join(
            [
                f"FitResult {urdf}: RMS torque error [{units}] {band}, on {data}",
                *table(head, rows),
                f"  mass [kg]: {masses}{more}",
                *notes(self.warnings),
            ]
        )


def fit(
    model: Model | Source,
    logs: Logs,
    *,
    validate: Logs = (),
    holdout: float = 0.3,
    method: Method = "ls",
    simulation: bool = True,
    quick: bool = False,
    progress: Progress | None = None,
) -> FitResult:
    """Identify inertias, friction and rotors; `idtool fit` as a function.

    Parameters
    ----------
    model
        The model, or its URDF.
    logs
        Logs to fit to: paths, read as the configuration says, or `Log`.
    validate
        Whole logs for validation; where given, nothing is held out of the others.
    holdout
        Share at the end of every log that is kept for validation, from 0 to below 1.
    method
        ``ls``, least squares, or ``iv``, instrumental variables, which noise in q and v does not bias; slower.
    simulation
        Whether to run the identified and the given model forwards too.
    quick
        Only the fit: nothing run forwards, not asked what each number rests on, whether several logs agree, and whether
        noise has biased it.
    progress
        Told the stage and the share of it that is done; None: silence.

    Raises
    ------
    IdtoolError
        If a log, the configuration or the model cannot be used: `LogError`, `ConfigError`, `ModelError`; or the
        problem was not solved: `SolverError`. Messages name options as the command line does.

    Examples
    --------
    >>> result = idtool.fit("sample_logs/leg.urdf", "sample_logs/leg_train.mcap", quick=True)
    >>> round(result.rms.validation["overall"], 2)
    0.11
    >>> result.bodies["shank_link"].realizable
    True
    """
    told = progress or silent
    experiment = experiment_of(model, logs, validate, holdout, told)
    options = changed(fit, holdout=holdout, method=method, simulation=simulation, quick=quick)
    made_by = call("fit", model, logs, validate=validate, **options)
    return fit_experiment(experiment, made_by, told, simulation and not quick, not quick, method)


def fit_experiment(
    experiment: Experiment,
    made_by: str,
    progress: Progress,
    simulate: bool = True,
    analyze_uncertainty: bool = True,
    method: Method = "ls",
) -> FitResult:
    """The same from model and logs put together.

    Parameters
    ----------
    experiment
        Model and data.
    made_by
        What the page says it was made by.
    progress, method
        As in `fit`.
    simulate
        Whether to run the identified and the given model forwards too.
    analyze_uncertainty
        If true, find the information source of each parameter, compare logs, and look for bias by noise.

    Raises
    ------
    IdtoolError
        As in `fit`.
    """
    found = run_fit(experiment, progress, simulate, analyze_uncertainty, method)
    if analyze_uncertainty:
        wrong = [fault for fault in faults(experiment, progress) if fault.fault in _SERIOUS]
        said = tuple(f"the data: {fault.joint or 'all joints'}: {fault.detail}" for fault in wrong)
        found = replace(found, warnings=(*said, *found.warnings))
    thetas = (experiment.equation.prior, found.estimate.theta)
    prior, own = (residual_maps(found.experiment, theta, progress) if analyze_uncertainty else {} for theta in thetas)
    report = fit_report(found)
    return FitResult(
        joints=tuple(report["joints"]),
        rms=Rms(**frozen(report["rms"])),
        rms_raw=Rms(**frozen(report["rms_raw"])),
        bodies=ReadOnly({name: body_of(name, body) for name, body in report["bodies"].items()}),
        friction=ReadOnly({joint: Friction(**frozen(terms)) for joint, terms in report["friction"].items()}),
        simulation=frozen(report["simulation"]),
        warnings=tuple(report["warnings"]),
        _fit=found,
        _maps=(prior, own) if analyze_uncertainty else None,
        _report=report,
        _made_by=made_by,
    )
