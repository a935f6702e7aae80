# %% [markdown]
# # Methods and the drift of joints
#
# Joints are constraints, which a method satisfies only approximately. With constraints on accelerations, the default,
# numerical error makes joints drift apart. How much depends on the method and on the step.

# %%
import numpy as np

import mbdkit

METHODS = {
    "RK-Gill": {"name": "rk-gill"},
    "Gauss 2": {"name": "gauss", "stages": 2},
    "Gauss 3": {"name": "gauss", "stages": 3},
}
TIME = {"end": 5.0, "step": 0.02}

runs = {label: mbdkit.run("double-pendulum", integrator=method, time=TIME) for label, method in METHODS.items()}
for label, run in runs.items():
    print(f"{label:8}  misalignment {run.misalignment_max:.1e} m, verdict {run.verdict}")

# %% [markdown]
# `mbdkit.plot.compare` draws the same quantity of several runs. The legend shows how the runs differ.

# %%
axes = mbdkit.plot.compare(list(runs.values()), kind="drift", joints="J2")

# %% [markdown]
# ## Order
#
# Half the step divides the misalignment by two to the power of the order: 16 for order four, 64 for order six.

# %%
for label, method in METHODS.items():
    found = [
        mbdkit.run("double-pendulum", integrator=method, time={"end": 5.0, "step": step}).misalignment_max
        for step in (0.04, 0.02)
    ]
    print(f"{label:8}  observed order {np.log2(found[0] / found[1]):.1f}")

# %% [markdown]
# ## Formulations without drift
#
# Projection returns the state to the constraints after each step. It removes the drift, but not the error of the
# motion, which a check estimates.

# %%
projected = mbdkit.run(
    "double-pendulum", integrator=METHODS["RK-Gill"], time=TIME, stabilization="projection", check=True
)
checked = mbdkit.run("double-pendulum", integrator=METHODS["RK-Gill"], time=TIME, check=True)
for label, run in {"without projection": checked, "with projection": projected}.items():
    print(f"{label:18}  misalignment {run.misalignment_max:.1e} m, error {run.accuracy.position_error_max:.1e} m")

# %% [markdown]
# ## Let mbdkit choose
#
# `accuracy` is the largest error of positions, as a share of the size of the mechanism. mbdkit chooses the method and
# the step, and confirms the result by a check.

# %%
chosen = mbdkit.run({"mbdkit": 1, "model": {"name": "double-pendulum"}, "time": {"end": 5.0}, "accuracy": 1e-6})
chosen
