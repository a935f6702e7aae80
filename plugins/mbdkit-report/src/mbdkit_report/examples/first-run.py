# %% [markdown]
# # A first run and its forces
#
# The lower leg of a seated person swings down from 20 degrees of flexion. The knee is a linkage of two rods; a spring
# behind the knee supports the leg. How large are the forces in the knee, with and without the spring?
#
# `check=True` repeats the run with smaller steps and with another method, and estimates the errors. A run at the end of
# a cell shows its verdict, the mechanism, the forces and the misalignment of the joints.

# %%
import numpy as np

import mbdkit
from mbdkit.spec.loading import load_spec

run = mbdkit.run("knee", check=True)
run

# %% [markdown]
# ## The motion
#
# The player can magnify the gaps in the joints. `run.animate().save("knee.gif")` writes a file.

# %%
run.animate()

# %% [markdown]
# ## Forces
#
# `run.joints`, `run.forces` and `run.bodies` have the results by name; type `run.joints["` and press Tab to see the
# names. Joints C and D connect the two rods to the thigh, so the force in the knee is the sum of their reactions.


# %%
def knee_force(run):
    """Return the force in the knee [N] at the recorded times."""
    force = run.joints["C"].reaction_force + run.joints["D"].reaction_force
    return np.hypot(force[:, 0], force[:, 1])


spring = run.forces["support"]
print(f"largest force in the knee:    {knee_force(run).max():.1f} N")
print(f"largest force of the spring:  {np.abs(spring.value).max():.1f} N")
print(f"errors of joint forces:       {run.accuracy.reaction_error.max():.1e} N")

# %% [markdown]
# `run.plot` has a method for each kind of plot, which takes and returns Matplotlib axes. The force of a spring is
# positive where it pulls, and negative where it pushes.

# %%
axes = run.plot.forces(elements="support")

# %% [markdown]
# ## Without the spring
#
# The second argument of `load_spec` changes keys of a spec, as `--set` does on the command line.

# %%
free = mbdkit.run(load_spec("knee", ["model.springs={}"]))
print(f"largest force in the knee without the spring: {knee_force(free).max():.1f} N")
axes = mbdkit.plot.compare([run, free], kind="reactions", joints="D")
axes.figure.savefig("knee-forces.pdf")

# %% [markdown]
# ## Keep the results
#
# An archive holds the spec, all results and the verdict. `mbdkit report knee.h5` makes a page of it.

# %%
run.save("knee.h5", overwrite=True)
print(mbdkit.load("knee.h5"))
