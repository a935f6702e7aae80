"""The parts of mbdkit, and what specs and archives may contain although the part that adds it is not installed."""

from __future__ import annotations

from collections.abc import Mapping

#: Names of the parts; `mbdkit_NAME` is the package, and `mbdkit-NAME` the word in messages.
PARTS = (
    "biomech",
    "builder",
    "contact",
    "design",
    "explore",
    "gradients",
    "gym",
    "identify",
    "paper",
    "predict",
    "report",
    "statics",
    "studies",
    "taylor",
    "testing",
    "transmissions",
    "wearable",
)

#: The packages of mbdkit itself: the core and its parts.
OWN_PACKAGES = ("mbdkit", *(f"mbdkit_{part}" for part in PARTS))

#: Parts by the keys of their elements in the model.
ELEMENTS_OF_PARTS: Mapping[str, str] = {
    "contacts": "mbdkit-contact",
    "muscles": "mbdkit-biomech",
    "cuffs": "mbdkit-wearable",
}

SECTIONS_OF_PARTS: Mapping[str, str] = {"contact": "mbdkit-contact"}  #: Parts by their sections of run specs.

#: Parts by the markers of their specs, which are not run specs where the part is not installed either.
MARKERS_OF_PARTS: Mapping[str, str] = {
    "mbdkit_study": "mbdkit-studies",
    "mbdkit_design": "mbdkit-design",
    "motion": "mbdkit-biomech",
    "mbdkit_predict": "mbdkit-predict",
    "mbdkit_identify": "mbdkit-identify",
}

#: Parts by their groups in archives.
GROUPS_OF_PARTS: Mapping[str, str] = (
    dict.fromkeys(("contacts", "ground_reactions"), "mbdkit-contact")
    | dict.fromkeys(("motion", "actuators", "muscles", "knees", "loads", "followers"), "mbdkit-biomech")
    | {"cuffs": "mbdkit-wearable"}
)
