"""idtool from Python: identify the sample leg, look at it, simulate it, ask what it lacks.

Run it from the repository's root, as a script or cell by cell in an editor that knows ``# %%``.
"""

# %% A log and a model
import idtool

log = idtool.Log("sample_logs/leg_train.mcap")
model = idtool.Model("sample_logs/leg.urdf")  # takes leg.yaml beside it
print(log)
print(model)

# %% Identify, and validate on a log that was not fitted
result = idtool.fit(model, log, validate="sample_logs/leg_validate.mcap", quick=True)
print(result)

# %% What was found
for name, error in result.rms.validation.items():
    print(f"{name}: {error:.3g} N·m, before {result.rms.prior_validation[name]:.3g}")
print(result.bodies["shank_link"])
print(result.bodies["shank_link"].inertia)
print(result.friction["hip"])

# %% Measured torque, predicted torque and what is left
figure = result.plot()  # a plotly figure: a notebook shows it, figure.show() opens it in a browser

# %% The identified model is a model like any other
validation = idtool.validate(result.model, "sample_logs/leg_validate.csv", prior=model, simulation=False)
print(validation)

# %% Run it forwards, half a second at a time
run = idtool.simulate(result.model, "sample_logs/leg_validate.mcap", window=0.5)
print(run)
motion = run.log.q  # (N, joints)

# %% What does the given model lack? Here nothing; without `effects` all effects compete, which takes minutes
diagnosis = idtool.diagnose(model, log, effects=["parallel_spring", "stribeck_friction"], simulation=False)
print(diagnosis)

# %% The files that the commands write
for path in (*result.save("leg_idtool"), *run.save("leg_idtool"), *diagnosis.save("leg_idtool", report_only=True)):
    print(path)
