# %% [markdown]
# # Your own mechanism and the torque of its motor
#
# A crank of 0.2 m turns once per second and moves a rod of 0.6 m whose other end slides along the x axis against a
# spring. Which torque does the motor need, and how much energy goes through it?

# %%
import json

import numpy as np
from scipy.integrate import trapezoid

import mbdkit

CRANK, ROD = 0.2, 0.6  # m

m = mbdkit.Mechanism(name="press")
crank = m.body("crank", mass=1.0, inertia=CRANK**2 / 12, position=(CRANK / 2, 0.0))
rod = m.body("rod", mass=2.0, inertia=2.0 * ROD**2 / 12, position=(CRANK + ROD / 2, 0.0))
m.revolute("A", m.ground, crank, at=(0.0, 0.0))
m.revolute("B", crank, rod, at=(CRANK, 0.0))
m.point_on_line("slot", m.ground, rod, at=(CRANK + ROD, 0.0), axis=(1.0, 0.0))
m.driver("motor", m.ground, crank, coordinate="angle", motion="2*pi*t")
m.spring_damper("spring", m.ground, rod, from_=(1.0, 0.0), to=(CRANK + ROD, 0.0), stiffness=300.0, free_length=0.2)
m.marker("tip", rod, at=(CRANK + ROD, 0.0))
m

# %% [markdown]
# ## Run it
#
# A mechanism needs a method and a time. The verdict `good` requires an estimate of the errors, `check=True`.

# %%
run = mbdkit.run(m, integrator={"name": "gauss", "stages": 2}, time={"end": 2.0, "step": 0.005}, check=True)
run

# %% [markdown]
# ## Torque and power of the motor
#
# The reaction torque of a driver is the torque that the motor exerts on the second body.

# %%
motor = run.joints["motor"]
torque = motor.reaction_torque
print(f"largest torque: {np.abs(torque).max():.2f} N m")
print(f"rms torque:     {np.sqrt(np.mean(torque**2)):.2f} N m")
print(f"largest power:  {motor.driver_power.max():.1f} W")
axes = run.plot.torques(joints="motor")

# %% [markdown]
# Spring and gravity are conservative, so the work of the motor over two whole turns is zero. The integral of its power
# confirms it.

# %%
work = trapezoid(motor.driver_power, run.time)
print(f"work over two turns: {work:.1e} J")
print(f"stroke of the tip:   {np.ptp(run.markers['tip'].position[:, 0]):.4f} m, twice the crank")

# %% [markdown]
# ## Without the motor
#
# If the motor is released, the mechanism comes to rest where the forces balance. `mbdkit.modes` finds how it vibrates
# about this position.

# %%
free = mbdkit.Mechanism.from_spec(m.to_spec())
del free.joints["motor"]
mbdkit.equilibrium(free)

# %%
mbdkit.modes(free)

# %% [markdown]
# ## Write the spec
#
# The mechanism as a file for the command line: `mbdkit run press.json`.

# %%
spec = {"mbdkit": 1, "model": m.to_spec(), "integrator": {"name": "gauss"}, "time": {"end": 2.0, "step": 0.005}}
with open("press.json", "w", encoding="utf-8") as file:
    json.dump(spec, file, indent=2)
print(mbdkit.run("press.json").status)
