"""Which bodies of a model move together, which can touch, and which do not stay in the plane."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations

import numpy as np

from mbdkit_robots.planar import GROUND, PARALLEL, Part, SpatialModel

#: Label of a shape, and the bit masks that say what it can touch: its type, and the types that it touches.
Shape = tuple[str, int, int]


def rigid_groups(model: SpatialModel) -> dict[str, str]:
    """Return for each part the first part of the group that is fixed together, such as GROUND."""
    groups = {GROUND: GROUND}
    for link in model.links:
        groups[link.child] = groups[link.parent] if link.kind == "fixed" else link.child
    return groups


def leave_out_contacts(
    model: SpatialModel,
    shapes: Mapping[str, Sequence[Shape]],
    excluded: Collection[frozenset[str]] = (),
    *,
    with_parents: bool = False,
) -> None:
    """Note the contacts that MuJoCo would look for, by its rules: shapes of the same rigid group do not collide, nor do
    those of neighbours in the tree, except with the ground.

    Parameters
    ----------
    shapes
        Shapes by body.
    excluded
        Pairs of bodies that do not collide.
    with_parents
        Whether neighbours collide, too.
    """
    groups = rigid_groups(model)
    parents = {link.child: groups[link.parent] for link in model.links}
    for first, second in combinations(shapes, 2):
        one_group, other_group = groups[first], groups[second]
        if one_group == other_group or frozenset((first, second)) in excluded:
            continue
        is_fixed = GROUND in (one_group, other_group)
        are_neighbours = parents.get(one_group) == other_group or parents.get(other_group) == one_group
        if are_neighbours and not is_fixed and not with_parents:
            continue
        touching = [
            (label, other_label)
            for label, kind, affinity in shapes[first]
            for other_label, other_kind, other_affinity in shapes[second]
            if kind & other_affinity or other_kind & affinity
        ]
        if touching and not is_fixed:
            model.leave_out("contacts between moving bodies", f"{first} and {second}", acts=True)
        for label in dict.fromkeys(pair[other_group == GROUND] for pair in touching if is_fixed):
            if label not in model.lacking.get("contacts with fixed geoms", ()):
                model.leave_out("contacts with fixed geoms", label, acts=True)


def leaving_bodies(model: SpatialModel, normal: np.ndarray) -> list[str]:
    """Return the free bodies whose motion does not stay in the plane.

    It stays there if the centres of mass of the body and of all bodies that it carries have the same height above the
    plane, the normal is a principal axis of each, and gravity and the points where loops close are in this plane.
    """
    groups = rigid_groups(model)
    trees = {GROUND: GROUND}
    for link in model.links:
        trees[link.child] = link.child if link.kind == "free" else trees[link.parent]
    for closure in model.closures:  # a weld to a body that stays in the plane keeps the whole tree there
        first, second = (trees[name] for name in closure.parts)
        if closure.kind == "weld" and GROUND in (first, second):
            trees = {name: GROUND if root in (first, second) else root for name, root in trees.items()}
    parts: dict[str, list[Part]] = {}
    for part in model.parts:
        if part.mass > 0 and trees[part.name] != GROUND:
            parts.setdefault(groups[part.name], []).append(part)
    heights: dict[str, list[float]] = {}
    is_oblique = abs(model.gravity @ normal) > PARALLEL * np.linalg.norm(model.gravity)
    leaving = dict.fromkeys(root for root in trees.values() if root != GROUND and is_oblique)
    size = max((float(np.max(np.abs(part.center))) for part in model.parts), default=0.0)
    for members in parts.values():
        root, whole = trees[members[0].name], Part.joined("", members)
        inertia = whole.inertia
        heights.setdefault(root, []).append(float(whole.center @ normal))
        size = max(size, float(np.sqrt(np.max(np.abs(inertia)) / whole.mass)))
        across = inertia @ normal
        if np.linalg.norm(across - (across @ normal) * normal) > PARALLEL * np.max(np.abs(inertia)):
            leaving[root] = None
    for closure in model.closures:
        for name in closure.parts:
            if trees[name] != GROUND:
                heights.setdefault(trees[name], []).append(float(closure.point @ normal))
    leaving |= {root: None for root, values in heights.items() if np.ptp(values) > PARALLEL * size}
    return list(leaving)
