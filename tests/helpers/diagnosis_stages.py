"""Stages of a diagnosis beside the search, for tests in which one of them fails: functions of `diagnosis.diagnose`."""

STAGES = (
    "find_data_faults",
    "order_effects",
    "evaluate_errors",
    "residual_structure",
    "structured_noise_floor",
    "localize_residual",
    "localize_unexplained",
    "effect_profile",
    "estimate_on_parts",
    "_held_out_notices",
    "residual_maps",
)
