# %% [markdown]
# # A study with your own measures
#
# Which spring behind the knee slows the leg, and what does it cost in joint force? A study runs all combinations of its
# axes, here of stiffness and damping, and keeps every run.

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
        "axes": [
            {"model.springs.support.stiffness": STIFFNESS},
            {"model.springs.support.damping": DAMPING},
        ],
    },
    out="springs",
)
study

# %% [markdown]
# ## Measures
#
# A measure is a number of a run. Any function of a run will do: here the largest force in the knee, the largest speed
# of the leg, and its angle at the end.


# %%
def peak_force(run):
    """Return the largest force in the knee [N]."""
    force = run.joints["C"].reaction_force + run.joints["D"].reaction_force
    return np.hypot(force[:, 0], force[:, 1]).max()


def peak_speed(run):
    """Return the largest angular speed of the leg [rad/s]."""
    return np.abs(run["shank"].angular_velocity).max()


def end_angle(run):
    """Return the angle of the leg at the end, from its start [rad]."""
    return run["shank"].angle[-1] - run["shank"].angle[0]


MEASURES = {"peak force [N]": peak_force, "peak speed [rad/s]": peak_speed, "end angle [rad]": end_angle}

found = {name: np.empty((len(STIFFNESS), len(DAMPING))) for name in MEASURES}
for point, run in study.runs():
    stiffness = STIFFNESS.index(point.axes["model.springs.support.stiffness"])
    damping = DAMPING.index(point.axes["model.springs.support.damping"])
    with run:
        for name, measure in MEASURES.items():
            found[name][stiffness, damping] = measure(run.check())

for name, values in found.items():
    print(f"{name:20} {np.array2string(values, precision=3).replace(chr(10), ' ')}")

# %%
figure, axes = plt.subplots(1, len(MEASURES), figsize=(9, 3), layout="constrained")
for ax, (name, values) in zip(axes, found.items(), strict=True):
    ax.plot(STIFFNESS, values, marker="o", label=[f"{damping:g} N s/m" for damping in DAMPING])
    ax.set(xlabel="stiffness [N/m]", ylabel=name)
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
