"""Error of a fitted model on the held-out data, and whether an effect makes these less likely."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.regressor import LinearModel

_CHANCE = 0.01  # change of the logarithm of a joint's squared error
_CLEAR = 0.1  # change of it that is not due to the inaccuracy of an effect elsewhere


def held_out_mean_squares(linearized: LinearizedFit, row_equation: LinearModel) -> Array:
    """Mean squared residual on the held-out data by joint.

    Rows near a reversal, where the filter rings, count too, unless the fit has a reversal margin.

    Parameters
    ----------
    linearized
        The model.
    row_equation
        Equation whose columns must be defined at a row for it to count.

    Returns
    -------
    Shape (nv,) [(N·m)² or N²]; NaN without held-out data.
    """
    equation = linearized.experiment.equation
    theta = linearized.estimate.theta
    squares = np.zeros(linearized.joint_count)
    count = np.zeros(linearized.joint_count)
    for run in linearized.experiment.runs:
        for batch in linearized.experiment.batches(run, held_out=True):
            if linearized.reversal_margin:
                masks = row_equation.clean_samples(batch, linearized.reversal_margin)
            else:
                masks = row_equation.valid_samples(batch)
            joints = zip(equation.active(), equation.filtered_columns(batch), masks, strict=True)
            for j, (active, columns, mask) in enumerate(joints):
                residual = columns[-1] - theta[active] @ columns[:-1]
                squares[j] += np.square(residual[mask]).sum()
                count[j] += mask.sum()
    with np.errstate(invalid="ignore"):
        return np.asarray(squares / count)


def lowers_held_out_likelihood(before: LinearizedFit, after: LinearizedFit) -> bool:
    """True if the held-out data are less likely under the model with an effect than under that without it.

    An effect that the held-out motion does not excite hardly changes the likelihood, and passes. So does one that is
    undefined where it acts, such as a play while the teeth are apart, if it makes all rows clearly more likely, those
    included. The arguments are those of `held_out_log_change`.
    """
    where_defined = held_out_log_change(before, after)
    if not where_defined > _CHANCE:
        return False
    everywhere = held_out_log_change(before, after, before.experiment.equation)
    return not everywhere < -_CLEAR


def held_out_log_change(before: LinearizedFit, after: LinearizedFit, row_equation: LinearModel | None = None) -> float:
    """Change of the logarithm of the held-out data's squared error by an effect, summed over the joints.

    Each joint's residual counts relative to its own size, so that a joint that still lacks a large effect does not
    decide alone. Without held-out data, it is 0.

    Parameters
    ----------
    before
        The model without the effect.
    after
        The model with it.
    row_equation
        Equation at whose rows they are compared; None: that with the effect.
    """
    row_equation = row_equation or after.experiment.equation
    errors_before = held_out_mean_squares(before, row_equation)
    errors_after = held_out_mean_squares(after, row_equation)
    with np.errstate(invalid="ignore"):
        change = np.log(errors_after / errors_before)
    return float(np.nansum(change))
