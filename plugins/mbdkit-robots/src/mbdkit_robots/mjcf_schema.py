"""What the reader of MJCF files understands, and what cannot change a motion: the names of the schema of MuJoCo 4.0.

The names are those that `mujoco.mj_printSchema` prints, sorted by their meaning in MuJoCo's XML reference. An attribute
that is in neither list makes a result doubtful, by its name.
"""

from __future__ import annotations

from xml.etree.ElementTree import Element

import numpy as np

from mbdkit_robots.documents import numbers
from mbdkit_robots.planar import SpatialModel

ORIENTATIONS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
_POSE = f"pos {' '.join(ORIENTATIONS)}"
_ROTOR = "armature damping ctrllimited ctrlrange forcelimited forcerange"
_TRANSMISSION = "joint jointinparent site refsite tendon body cranksite slidersite cranklength lengthrange gear"
_CONTROL = f"{_TRANSMISSION} delay interp nsample input"
_LABELS = "name class group user"

UNDERSTOOD = {
    "compiler": "angle eulerseq inertiafromgeom autolimits balanceinertia boundmass boundinertia settotalmass "
    "inertiagrouprange coordinate",
    "option": "gravity density viscosity",
    "flag": "contact filterparent gravity passive spring damper frictionloss limit equality constraint",
    "body": f"name childclass {_POSE} gravcomp",
    "inertial": f"{_POSE} mass diaginertia fullinertia",
    "joint": "type axis pos ref stiffness damping springref springdamper frictionloss armature range limited "
    "actuatorfrcrange actuatorfrclimited",
    "geom": f"type size fromto {_POSE} mass density shellinertia mesh contype conaffinity",
    "equality": "active body1 body2 site1 site2 anchor relpose torquescale joint1 joint2 polycoef",
    "actuator": f"{_ROTOR} actlimited actrange dyntype gaintype biastype",
    "exclude": "body1 body2",
}
"""Attributes that the reader understands, by element; `actuator` stands for all actuators."""

WITHOUT_EFFECT = {
    "compiler": "strippath meshdir texturedir assetdir discardvisual usethread fusestatic fitaabb alignfree "
    "saveinertial savecompiled savecanonical conflict passthrough",
    # integrator, solver and collisions; the wind acts only if the medium has a density or viscosity
    "option": "timestep integrator solver iterations tolerance ls_iterations ls_tolerance noslip_iterations "
    "noslip_tolerance ccd_iterations ccd_tolerance sdf_iterations sdf_initpoints sleep_tolerance jacobian cone "
    "impratio o_margin o_solref o_solimp o_friction wind magnetic actuatorgroupdisable",
    "flag": "actuation autoreset clampctrl diagexact energy eulerdamp fwdinv invdiscrete island midphase multiccd "
    "nativeccd override refsafe sensor speculative warmstart",
    "body": "simple fuse user sleep",
    "inertial": "",
    "joint": f"{_LABELS} actuatorgravcomp solreflimit solimplimit solreffriction solimpfriction",
    "freejoint": "name group align",
    # of contacts, which are left out by name, of fluids, and of looks
    "geom": f"{_LABELS} condim friction gap margin priority solmix solref solimp surfacevel adhesion fluidcoef "
    "fluidshape rgba material castshadow hfield fitscale",
    "equality": "name class solref solimp",
    # an actuator without control exerts no force at any gain, and its transmission does not matter
    "actuator": f"{_LABELS} {_CONTROL} gain kv gainprm dynprm biasprm actearly",
    "exclude": "name",
}
"""Attributes that cannot change a motion that the reader understands, by element."""

LISTS = ("size", "stiffness", "damping", "friction", "solref", "solimp", "gear", "dynprm", "gainprm", "biasprm")
"""Attributes whose missing last numbers are inherited."""
ZERO = ("springyield", "margin", "gravcomp")
"""Attributes that have no effect if they are zero."""
OFF = {"mocap": "false", "sleep": "disable", "ipc": "disable"}
"""Values of attributes that have no effect."""

MODEL_SECTIONS = ("compiler", "option", "default", "worldbody", "equality", "contact", "actuator")
"""Sections that the reader understands."""
IDLE_SECTIONS = ("size", "statistic", "visual", "asset", "custom", "extension")
"""Sections without effect by themselves: extensions and assets act through the elements that refer to them."""
NOTED_SECTIONS = ("sensor", "keyframe")
"""Sections that are ignored, with a warning."""
LACKING_SECTIONS = {"tendon": "tendons", "deformable": "deformable objects"}
"""Sections that are ignored although they change the motion, and words for their elements."""
BODY_PARTS = ("body", "inertial", "joint", "freejoint", "geom", "site", "camera", "light")
"""Elements of a body that the reader understands, or that have no effect."""

ACTUATORS = (
    *("general", "motor", "position", "velocity", "intvelocity", "orientation", "pid", "damper", "cylinder", "muscle"),
    *("adhesion", "dcmotor", "plugin"),
)
"""Elements of <actuator>."""
WITHOUT_FORCE = ("motor", "damper", "adhesion")
"""Actuators that exert no force while their control is zero."""
INHERITED = (*f"{_ROTOR} {_CONTROL} {_LABELS}".split(),)
"""Attributes that a shortcut such as <motor> inherits from the default of another one; it resets the force law."""


def leave_out_attributes(model: SpatialModel, element: Element, label: str, kind: str = "") -> None:
    """Note the attributes of an element that may change the motion but are not understood; `kind` is the key of the
    lists if it is not the tag.
    """
    kind = kind or element.tag
    known = f"{UNDERSTOOD.get(kind, '')} {WITHOUT_EFFECT.get(kind, '')}".split()
    for name, text in element.attrib.items():
        if name in known or text == OFF.get(name) or (name in ZERO and not np.any(numbers(element, name, "0"))):
            continue
        model.leave_out(f"{name} of <{element.tag}>", label, acts=True)
