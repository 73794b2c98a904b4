"""idtool from Python: identify the sample leg, inspect the result, simulate the model, and look for missing effects.

Run it in the root of the repository, as a script or cell by cell in an editor that supports ``# %%``.
"""

# %% A log and a model
import idtool

log = idtool.Log("sample_logs/leg_train.mcap")
model = idtool.Model("sample_logs/leg.urdf")  # also reads leg.yaml beside it
print(log)
print(model)

# %% Identify, and validate on a log that was not used for the fit
result = idtool.fit(model, log, validate="sample_logs/leg_validate.mcap", quick=True)
print(result)

# %% Errors and identified parameters
for name, error in result.rms.validation.items():
    print(f"{name}: {error:.3g} N·m, before {result.rms.prior_validation[name]:.3g}")
print(result.bodies["shank_link"])
print(result.bodies["shank_link"].inertia)
print(result.friction["hip"])

# %% Measured torque, predicted torque and residual
figure = result.plot()  # a Plotly figure: a notebook shows it, figure.show() opens it in a browser

# %% The identified model can be used like any other model
validation = idtool.validate(result.model, "sample_logs/leg_validate.csv", prior=model, simulation=False)
print(validation)

# %% Simulate it, with a restart every half second
run = idtool.simulate(result.model, "sample_logs/leg_validate.mcap", window=0.5)
print(run)
motion = run.log.q  # (N, joints)

# %% Look for missing effects. There are none here. Without `effects`, all effects are tried, which takes minutes
diagnosis = idtool.diagnose(model, log, effects=["parallel_spring", "stribeck_friction"], simulation=False)
print(diagnosis)

# %% Write the same files as the commands
for path in (*result.save("leg_idtool"), *run.save("leg_idtool"), *diagnosis.save("leg_idtool", report_only=True)):
    print(path)
