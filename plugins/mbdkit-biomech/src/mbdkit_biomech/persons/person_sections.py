"""Sections of a spec of inverse dynamics of a person: the person, the plane of motion, joint centres, and how
well they are known.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from mbdkit.base.errors import SpecError
from mbdkit.spec.sections import Count, Section

Marker = Annotated[str, Field(min_length=1)]


class Subject(Section):
    """The person whose markers were measured. The model, whose own height and mass are those for which its muscles are
    given, is scaled to this person.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = ("sex", "age", "replacement")

    mass: Annotated[float, Field(gt=0, le=500)]
    """Body mass [kg]."""
    height: Annotated[float, Field(gt=0, le=3)]
    """Body height [m]."""
    sex: Literal["female", "male"] | None = None
    """Which of de Leva's tables gives masses, centres of mass and radii of gyration of the segments; by default, the
    mean of both."""
    age: Annotated[float, Field(ge=18, le=110)] | None = None
    """Age [a], from which the strength of the muscles follows; by default, that of adults of unknown age."""
    replacement: dict[Literal["left", "right"], Literal["knee"]] = Field(default_factory=dict)
    """Joints that have been replaced, by side; muscles of such a knee are weaker."""

    @property
    def table(self) -> Literal["de-leva", "de-leva-female", "de-leva-male"]:
        """Name of the table of the segments."""
        return "de-leva" if self.sex is None else "de-leva-female" if self.sex == "female" else "de-leva-male"

    @property
    def described(self) -> str:
        """The person in words."""
        age = None if self.age is None else f"{self.age:g} years"
        replaced = [f"{side} {joint} replaced" for side, joint in self.replacement.items()]
        return ", ".join(filter(None, [f"{self.mass:g} kg", f"{self.height:g} m", age, self.sex, *replaced]))

    @property
    def replaced_knees(self) -> list[str]:
        """Sides of the knees that have been replaced."""
        return [side for side, joint in self.replacement.items() if joint == "knee"]


class PlaneAxes(Section):
    """The plane of motion, by axes of the laboratory."""

    forward: Literal["x", "-x", "y", "-y", "z", "-z"]
    """Axis of the laboratory in the direction in which the person faces."""
    up: Literal["z", "y"]
    """Axis of the laboratory that points up."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError if both axes are the same."""
        if self.forward[-1] == self.up:
            raise SpecError("is the axis that points up; choose one of the horizontal axes", key="forward")


class Midpoint(Section):
    """A joint centre midway between two landmarks."""

    midpoint: tuple[Marker, Marker]
    """Markers on the medial and the lateral side of the joint, in the static trial if it has them, otherwise in the
    motion."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError if both landmarks are the same."""
        if len(set(self.midpoint)) == 1:
            raise SpecError("names one marker twice", key="midpoint")


CenterMethod = Literal["functional", "hip-regression", "static"]
#: Keys of `motion` that only specs with `subject` have.
OF_PERSONS = ("plane", "clusters", "centers", "static")

Center = CenterMethod | Midpoint


Distance = Annotated[float, Field(ge=0, le=0.1)]
Angle = Annotated[float, Field(ge=0, le=0.5)]
Share = Annotated[float, Field(ge=0, le=1)]
Duration = Annotated[float, Field(ge=0, le=0.2)]
Exponent = Annotated[float, Field(ge=2, le=20)]
Activation = Annotated[float, Field(ge=0, lt=1)]


class Uncertainty(Section):
    """How well a person, its loads and its muscles are known; the error bars contain the effects.

    Numbers are standard deviations. Those of shares are standard deviations of the logarithms, which are about the
    relative standard deviations. With `subject`, keys that are left out have the defaults stated here; otherwise, they
    are 0. Each scalar varies independently.
    """

    ABSENT_BY_DEFAULT: ClassVar[tuple[str, ...]] = (
        *("centers", "lengths", "masses", "inertias", "max_force", "optimal_length", "tendon_length"),
        *("muscle_points", "muscle_delay", "pressure", "plate_gain", "angles", "exponent", "minimum", "devices"),
        *("extensor_arm", "cocontraction"),
    )

    centers: Distance | dict[str, Distance] | None = None
    """Joint centres of a person, forward and up [m], one value for all or one by joint; by default, the covariances of
    their calibration."""
    lengths: Share | None = None
    """Distances in each segment from its centre of mass, in addition to what follows from the centres; default 0."""
    masses: Share | dict[str, Share] | None = None
    """Mass of each segment, one value for all or one by segment; default 0.2 for thighs, 0.3 for feet, and 0.1 for
    others."""
    inertias: Share | dict[str, Share] | None = None
    """Moment of inertia of each segment, at constant mass; default 0.3 for shanks, 0.6 for feet, and 0.2 for others."""
    max_force: Share | None = None
    """Isometric forces: of a factor of all muscles together, and of one factor for each muscle; default 0.2."""
    optimal_length: Share | None = None
    """Optimal length of the fibres of each muscle; default 0.05."""
    tendon_length: Share | None = None
    """Length of the tendon of each muscle; default 0.02."""
    muscle_points: Distance | None = None
    """Points of each muscle on each body, which move together, along both axes of the body [m]; default 0.005."""
    extensor_arm: Annotated[float, Field(ge=0, le=3)] | None = None
    """Factor of the standard deviation, by angle, of the lever arm of each `patella` between persons and sources;
    default 1."""
    cocontraction: tuple[Activation, Activation] | None = None
    """Largest least activations of extensors and flexors of a knee together, which are 0 for one half of persons, and
    uniform from 0 for the other half: around the beginning of the stance, and in its second half; default [0.15,
    0.08]."""
    muscle_delay: Duration | None = None
    """Time by which the forces of all muscles are early or late [s]; default 0.02."""
    pressure: Distance | None = None
    """Point of application of each load with a point in the global frame, along x [m]; default 0.005."""
    plate_gain: Share | None = None
    """Factor of the force of each load; default 0.01."""
    angles: Angle | None = None
    """Zero of each observed angle [rad]. The default for a person is the scatter in the static trial or on the flat
    foot, and 0.05 for a trunk without static trial."""
    exponent: tuple[Exponent, Exponent] | None = None
    """Range of the exponent of recruitment; default [2, 4] if it contains `recruitment.exponent`."""
    minimum: tuple[Activation, Activation] | None = None
    """Range of the smallest activation; default [0.01, 0.05] if it contains `recruitment.minimum`."""
    devices: dict[str, Annotated[float, Field(ge=0)]] | None = None
    """Uncertain numbers of worn devices that follow the motion: `misfit_x`, `misfit_y` [m] and `misfit_angle` [rad],
    which are added to its offset, and `tissue`, the share by which the stiffness of all its cuffs may be wrong."""
    samples: Annotated[Count, Field(ge=20)] = 500
    """Number of samples of all scalars together."""

    def model_post_init(self, _context: object) -> None:
        """Raise SpecError if a range is not in order."""
        for key in ("exponent", "minimum"):
            if (own := getattr(self, key)) is not None and not own[0] <= own[1]:
                raise SpecError(f"should be a range [lowest, highest], not [{own[0]:g}, {own[1]:g}]", key=key)
