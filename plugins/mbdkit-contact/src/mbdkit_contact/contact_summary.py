"""What the summary of a run says of contacts, and its headlines."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mbdkit.archive.headlines import EXACT, JOINTS_NAMED, MISSED, Headline, largest_of, run_headlines
from mbdkit.archive.result_seams import summary_lines
from mbdkit.archive.run import Run
from mbdkit.archive.run_summary import few, ranked, summarize_impacts
from mbdkit.base.errors import MbdkitError
from mbdkit.base.text import listed
from mbdkit_contact.modes import SLIP, STICK


@run_headlines
def largest_forces(run: Run) -> list[Headline]:
    """Return the largest normal forces of contacts; the two largest are headlines."""
    if not run.records("contacts/normal_force"):
        return []
    names, force = list(run.contacts), run.array("contacts/normal_force")
    found = largest_of("normal force at", run, "contacts.normal_force", names, force, "N", None)
    return [one._replace(is_main=number < 2) for number, one in enumerate(found)]


@summary_lines
def contact_lines(run: Run) -> list[tuple[str, str]]:
    """Return the line of the summary about contacts."""
    return [("contacts", _overlaps(run))]


def _overlaps(run: Run) -> str:
    """Return the deepest overlaps of contacts with their times, their largest creep (slip while they stick), and how
    far they slip otherwise.

    The deepest overlap comes first; rounding errors are left out.
    """
    if not run.contacts:
        return ""
    overlaps, parts = -np.stack([contact.gap for contact in run.contacts.values()], axis=1), []
    missed = run.errors.missed("-contacts.gap", list(run.contacts), overlaps)
    beyond = np.zeros(len(run.contacts)) if missed is None else missed
    for (name, contact), own, unseen in zip(run.contacts.items(), overlaps.T, beyond, strict=True):
        row, known = int(np.argmax(own)), float(np.nan_to_num(unseen))
        if (depth := float(own[row] + known)) > EXACT:
            when = f"at {run.time[row]:.4g} s" if known <= MISSED * depth else "between the recorded rows"
            when += " in the recorded rows" if np.isnan(unseen) else ""
            creep = np.max(np.abs(contact.slip[contact.mode == STICK]), initial=0.0)
            crept = f", creeps at up to {creep:.2g} m/s" if creep > EXACT else ""
            path = float(np.trapezoid(np.where(contact.mode == SLIP, np.abs(contact.slip), 0.0), run.time))
            slipped = f", slips {path:.2g} m" if path > EXACT else ""
            parts.append((depth, f"{name} overlaps by up to {depth:.3g} m {when}{crept}{slipped}"))
    if not parts:
        return f"no overlap above {EXACT:g} m{' in the recorded rows' if np.any(np.isnan(beyond)) else ''}"
    return few(ranked(parts))


@summary_lines
def impact_lines(run: Run) -> list[tuple[str, str]]:
    """Return the line of the summary about impacts of contacts."""
    return [("impacts", _impacts(run))]


def _impacts(run: Run) -> str:
    """Return the number of impacts of each contact, the largest of their impulses and the energy that they lose.

    Time-stepping does not locate impacts; the text then says that contact forces include them.
    """
    if (run.spec.get("contact") or {}).get("treatment") == "time-stepping":
        return "not located: the contact force of a step with an impact includes its impulse, divided by the step"
    impacts, counted = run.impacts, summarize_impacts(run, of_drivers=False)
    if counted is None:
        return ""
    some, who, change = counted
    largest = np.max(np.abs(impacts.normal_impulse))
    given = _restitutions(run, np.unique(impacts.contact[some].astype(str)))
    return f"{who}, {given}impulses up to {largest:.4g} N s, {change}; contact forces do not include impulses"


def _restitutions(run: Run, struck: np.ndarray) -> str:
    """Return the restitution of the contacts with these names, and a comma; empty if the spec cannot be read."""
    try:
        contacts: Mapping[str, Any] = run.mechanism.elements.get("contacts", {})
        joints = run.mechanism.joints
    except MbdkitError:
        return ""
    known = {
        pair.name: contact.restitution for name, contact in contacts.items() for pair in contact.pairs(name, joints)
    }
    values = dict.fromkeys(f"{known[name]:g}" for name in struck if name in known)
    return f"restitution {listed([*values][:JOINTS_NAMED], 'and')}, " if values else ""
