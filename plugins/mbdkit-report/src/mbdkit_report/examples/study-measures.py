# %% [markdown]
# # A study with your own measures
#
# Which spring behind the knee slows the leg, and what does it cost in joint force? A study runs all combinations of its
# axes, here of stiffness and damping, and keeps every run. A measure is a number of a run, written as an expression;
# `mbdkit guide measures` lists functions and quantities.

# %%
import matplotlib.pyplot as plt
import numpy as np

import mbdkit

STIFFNESS, DAMPING = [150.0, 300.0, 600.0], [30.0, 60.0]  # N/m, N s/m

study = mbdkit.study(
    {
        "mbdkit_study": 1,
        "title": "Springs behind the knee",
        "base": "knee",
        "overrides": {"time": {"end": 2.0, "step": 0.01}},
        "axes": [{"model.springs.support.stiffness": STIFFNESS}, {"model.springs.support.damping": DAMPING}],
        "measures": {
            "peak_force": "max(abs(joints.C.force + joints.D.force))",
            "peak_speed": "max(abs(shank.angular_velocity))",
            "swing": {"value": "final(shank.angle) - at(shank.angle, 0)", "unit": "deg"},
        },
    },
    out="springs",
)
study

# %% [markdown]
# ## Measures
#
# `point.values` are the measures of a run; `study.to_frame()` returns all of them as a table, and `study.measures` has
# their units.

# %%
found = {
    name: np.array([point.values[name] for point in study.points]).reshape(len(STIFFNESS), len(DAMPING))
    for name in study.measures
}
for name, values in found.items():
    print(f"{name} [{study.measures[name].units}]: {values.min():.4g} to {values.max():.4g}")

# %% [markdown]
# A measure that cannot be written as an expression is a function of a run, such as the time of the largest force.


# %%
def peak_time(run):
    """Return the time of the largest force in the knee [s]."""
    force = run.joints["C"].reaction_force + run.joints["D"].reaction_force
    return run.time[np.argmax(np.hypot(force[:, 0], force[:, 1]))]


for point, run in study.runs():
    with run:
        print(f"{point.label}: {peak_time(run):.2f} s")

# %%
figure, axes = plt.subplots(1, len(found), figsize=(9, 3), layout="constrained")
for ax, (name, values) in zip(axes, found.items(), strict=True):
    ax.plot(STIFFNESS, values, marker="o", label=[f"{damping:g} N s/m" for damping in DAMPING])
    ax.set(xlabel="stiffness [N/m]", ylabel=f"{name} [{study.measures[name].units}]")
axes[0].legend(title="damping")
figure.savefig("springs.pdf")

# %% [markdown]
# ## One of the runs
#
# `study.points` are the runs with their values on the axes. The runs are in the folder `springs`; the same call
# computes only what is missing, and `mbdkit report springs` compares them on one page.

# %%
softest = study.run(study.points[0])
softest
