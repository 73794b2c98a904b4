"""Error of a fitted model on the held-out data, and whether an effect makes these data less likely."""

from __future__ import annotations

import numpy as np

from idtool.common.arrays import Array
from idtool.diagnosis.error_summary import NEGLIGIBLE_SHARE
from idtool.diagnosis.linearized_fit import LinearizedFit
from idtool.dynamics.regressor import LinearModel

_MAX_LOG_INCREASE = 0.01  # by chance, of the logarithm of the squared error, summed over the joints
_CLEAR_LOG_DECREASE = 0.1  # of it, that outweighs what the inaccuracy of an effect costs elsewhere


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
            row_filter = equation.row_filter(batch, row_equation, linearized.reversal_margin or None)
            all_columns = equation.filtered_columns(batch, row_filter)
            joints = zip(equation.active(), all_columns, row_filter.shares, strict=True)
            for j, (active, columns, shares) in enumerate(joints):
                residual = columns[-1] - theta[active] @ columns[:-1]
                squares[j] += np.square(residual[shares.astype(bool)]).sum()
                count[j] += shares.sum()
    with np.errstate(invalid="ignore"):
        return np.asarray(squares / count)


def lowers_held_out_likelihood(before: LinearizedFit, after: LinearizedFit) -> bool:
    """True if the held-out data are less likely under the model with an effect than under that without it.

    The rows at which the model with the effect is defined decide.

    A backlash is undefined while its teeth are apart, and acts just then. So an effect that makes these rows less
    likely is accepted all the same if it makes all rows together clearly more likely.

    An effect that the held-out motion does not excite changes hardly anything. It is accepted.

    Parameters
    ----------
    before, after
        The models without the effect and with it.
    """
    change_where_defined = held_out_log_change(before, after, after.experiment.equation)
    if change_where_defined <= _MAX_LOG_INCREASE:
        return False
    change_at_all_rows = held_out_log_change(before, after, before.experiment.equation)
    is_clearly_more_likely = change_at_all_rows < -_CLEAR_LOG_DECREASE
    return not is_clearly_more_likely


def held_out_log_change(before: LinearizedFit, after: LinearizedFit, row_equation: LinearModel) -> float:
    """Change of the logarithm of the held-out data's squared error by an effect, summed over the joints.

    A negative change is an improvement. Without held-out data, the change is 0.

    Each joint counts relative to its own error. So a joint that still lacks a large effect does not decide alone. An
    increase that is negligible beside the joint's torque does not count. So a joint with little noise does not either.

    Parameters
    ----------
    before, after
        The models without the effect and with it.
    row_equation
        Equation whose columns must be defined at a row for it to count.
    """
    squares_before = held_out_mean_squares(before, row_equation)
    squares_after = held_out_mean_squares(after, row_equation)
    negligible = np.square(NEGLIGIBLE_SHARE * before.rms_torque)
    with np.errstate(invalid="ignore"):
        change = np.log(squares_after / squares_before)
        is_negligible = (change > 0) & (squares_after - squares_before < negligible)
    return float(np.nansum(np.where(is_negligible, 0.0, change)))
