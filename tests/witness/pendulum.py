"""The large-angle compound pendulum in closed form: Jacobi elliptic functions, evaluated with 40 digits.

A rigid body of mass m and inertia J about its centre of mass swings about a fixed pin at the distance a from it.
With phi the angle from the downward vertical and w0^2 = m g a / (J + m a^2), the equation phi'' = -w0^2 sin(phi)
has the energy integral k^2 = sin^2(phi/2) + (phi'/(2 w0))^2 and

    k < 1 (libration)   sin(phi/2) = k sn(w0 t + u0, k^2)        phi' = 2 k w0 cn(w0 t + u0, k^2)
    k > 1 (rotation)    phi/2 = am(k w0 t + u0, 1/k^2)           phi' = 2 k w0 dn(k w0 t + u0, 1/k^2)

Sources: Whittaker, A Treatise on the Analytical Dynamics of Particles and Rigid Bodies, 4th ed. 1937, section 44;
NIST Digital Library of Mathematical Functions, sections 22.13 and 22.19(i).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import mpmath
import numpy as np
from numpy.typing import NDArray

DIGITS = 40


@dataclass(frozen=True)
class Pendulum:
    """A compound pendulum on a pin at the origin; a uniform rod by default.

    Parameters
    ----------
    mass, arm, inertia
        Mass [kg], distance from pin to centre of mass [m], inertia about the centre of mass [kg m^2].
    angle, rate
        Tilt of the line from pin to centre of mass at t = 0, from the +x axis [rad], and its rate [rad/s].
    gravity
        Downward acceleration of gravity [m/s^2].
    """

    mass: float = 1.0
    arm: float = 0.5
    inertia: float = 1.0 / 12.0
    angle: float = 0.0
    rate: float = 0.0
    gravity: float = 9.81

    @classmethod
    def rod(cls, length: float = 1.0, mass: float = 1.0, angle: float = 0.0, rate: float = 0.0) -> Pendulum:
        """Return the pendulum that is a uniform rod of `length` [m] hung from its end."""
        return cls(mass=mass, arm=length / 2.0, inertia=mass * length**2 / 12.0, angle=angle, rate=rate)

    def motion(self, times: Sequence[float] | NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the angle from the +x axis [rad] (never wrapped) and its rate [rad/s] at `times` [s], each (T,)."""
        with mpmath.workdps(DIGITS):
            pairs = [self._state(mpmath.mpf(float(time))) for time in times]
            downward = mpmath.pi / 2
            return (
                np.array([float(phi - downward) for phi, _ in pairs]),
                np.array([float(rate) for _, rate in pairs]),
            )

    def position(self, times: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the centre of mass [m] at `times` [s], shape (T, 2), free of the rounding of the angle."""
        with mpmath.workdps(DIGITS):
            angles = [self._state(mpmath.mpf(float(time)))[0] for time in times]
            return np.array([[float(self.arm * mpmath.sin(p)), float(-self.arm * mpmath.cos(p))] for p in angles])

    def pin_force(self, times: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the force of the pin on the body [N], shape (T, 2), from the energy integral.

        Along the body, from the centre of mass to the pin, m g cos(phi) + m a phi'^2 with
        phi'^2 = phi0'^2 + 2 w0^2 (cos(phi) - cos(phi0)); across it, m g sin(phi) (1 - m a^2 / (J + m a^2)).
        For a uniform rod released at rest that is m g (5 cos(phi) - 3 cos(phi0)) / 2 and m g sin(phi) / 4.
        """
        forces = []
        with mpmath.workdps(DIGITS):
            mass, arm, inertia, gravity = (
                mpmath.mpf(value) for value in (self.mass, self.arm, self.inertia, self.gravity)
            )
            about_pin = inertia + mass * arm**2
            start = mpmath.mpf(self.angle) + mpmath.pi / 2
            for time in times:
                phi = self._state(mpmath.mpf(float(time)))[0]
                drop = mpmath.cos(phi) - mpmath.cos(start)
                rate_squared = mpmath.mpf(self.rate) ** 2 + 2 * mass * gravity * arm / about_pin * drop
                along = mass * gravity * mpmath.cos(phi) + mass * arm * rate_squared
                across = mass * gravity * mpmath.sin(phi) * (1 - mass * arm**2 / about_pin)
                inward = (-mpmath.sin(phi), mpmath.cos(phi))
                sideways = (mpmath.cos(phi), mpmath.sin(phi))
                forces.append([float(along * i + across * s) for i, s in zip(inward, sideways, strict=True)])
        return np.array(forces)

    def _state(self, time: mpmath.mpf) -> tuple[mpmath.mpf, mpmath.mpf]:
        """Return phi (from the downward vertical) and phi' at `time`, in the working precision."""
        mass, arm = mpmath.mpf(self.mass), mpmath.mpf(self.arm)
        frequency = mpmath.sqrt(mass * self.gravity * arm / (mpmath.mpf(self.inertia) + mass * arm**2))
        phi = mpmath.mpf(self.angle) + mpmath.pi / 2
        half_rate = mpmath.mpf(self.rate) / (2 * frequency)
        modulus_squared = mpmath.sin(phi / 2) ** 2 + half_rate**2
        modulus = mpmath.sqrt(modulus_squared)
        if modulus_squared < 1:
            turns = mpmath.nint(phi / (2 * mpmath.pi))  # sin(phi/2) and cos(phi/2) both change sign at each turn
            sign = -1 if int(turns) % 2 else 1
            amplitude = mpmath.atan2(sign * mpmath.sin(phi / 2) / modulus, half_rate / modulus)
            u = frequency * time + mpmath.ellipf(amplitude, modulus_squared)
            sine = mpmath.ellipfun("sn", u, m=modulus_squared)
            cosine = mpmath.ellipfun("cn", u, m=modulus_squared)
            return 2 * mpmath.asin(modulus * sine) + 2 * mpmath.pi * turns, 2 * modulus * frequency * cosine
        if modulus_squared == 1:
            raise ValueError("On the separatrix the pendulum has no elliptic period; start with another energy.")
        parameter = 1 / modulus_squared
        direction = 1 if self.rate > 0 else -1
        u = direction * modulus * frequency * time + mpmath.ellipf(phi / 2, parameter)
        half_period = 2 * mpmath.ellipk(parameter)
        halves = mpmath.nint(u / half_period)
        rest = u - halves * half_period
        sine, cosine, delta = (mpmath.ellipfun(kind, rest, m=parameter) for kind in ("sn", "cn", "dn"))
        amplitude = mpmath.atan2(sine, cosine) + halves * mpmath.pi
        return 2 * amplitude, direction * 2 * modulus * frequency * delta
