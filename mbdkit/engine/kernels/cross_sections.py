"""Beams: forces, tangents and internal forces of their elements, evaluated at cross-sections.

An element of two or three nodes is integrated at one or two cross-sections. The state of a cross-section, the
derivatives of its position with respect to the arc length, its angle and the derivative of its angle, is a linear
function of the coordinates of the nodes. Its strains, forces and tangents are generated from the strain energy
(`mbdkit_statics.element_definitions.derive_section`). Angles are interpolated and not wrapped, so that a beam may make
many turns.
"""

from __future__ import annotations

from mbdkit.engine.kernels.angles import cosine_and_sine
from mbdkit.engine.kernels.element_kernels import section_forces, section_tangents
from mbdkit.engine.kernels.table_rows import SECTION
from mbdkit.engine.native.functions import inlined, subkernel

#: Numbers of values per cross-section in ``Scratch.section`` and ``Topology.section_parameters``.
STATE, PARAMETERS = 10, 16
NODES = 3  #: Largest number of nodes of an element.


@subkernel
def evaluate_sections(top, w, q, v):
    """Write state, force, stress and energy of every cross-section into the arrays ``w.section*`` (G, ...)."""
    sections, p, z = top.sections, top.section_parameters, w.section
    for k in range(len(sections)):
        for i in range(8):
            z[k, i] = 0.0
        for i in range(sections[k, SECTION.node_count]):
            node, shape, slope = 3 * sections[k, SECTION.node + i], p[k, i], p[k, NODES + i]
            z[k, 0] += slope * q[node]
            z[k, 1] += slope * q[node + 1]
            z[k, 2] += shape * q[node + 2]
            z[k, 3] += slope * q[node + 2]
            z[k, 4] += slope * v[node]
            z[k, 5] += slope * v[node + 1]
            z[k, 6] += shape * v[node + 2]
            z[k, 7] += slope * v[node + 2]
        z[k, 8], z[k, 9] = cosine_and_sine(z[k, 2])
        section_forces(k, z, p, w.section_force, w.section_stress, w.section_energy)


@subkernel
def add_beam_forces(top, w, q, v):
    """Add the forces of all beams to ``w.force`` (3 (B + 1),)."""
    evaluate_sections(top, w, q, v)
    sections, p, given, force = top.sections, top.section_parameters, w.section_force, w.force
    for k in range(len(sections)):
        for i in range(sections[k, SECTION.node_count]):
            node, shape, slope = 3 * sections[k, SECTION.node + i], p[k, i], p[k, NODES + i]
            # virtual work: nodal forces are the section forces times shape functions of the states
            force[node] -= slope * given[k, 0]
            force[node + 1] -= slope * given[k, 1]
            force[node + 2] -= shape * given[k, 2] + slope * given[k, 3]


@subkernel
def beam_tangents(top, w, q, v):
    """Write K = -dQ/dq and C = -dQ/dv of every cross-section into ``w.beam_stiff`` and ``w.beam_damp`` (G, 81)."""
    evaluate_sections(top, w, q, v)
    sections, p = top.sections, top.section_parameters
    for k in range(len(sections)):
        section_tangents(k, w.section, p, w.section_stiff, w.section_damp)
        for i in range(sections[k, SECTION.node_count]):
            for j in range(sections[k, SECTION.node_count]):
                _spread(p, k, i, j, w.section_stiff, w.beam_stiff)
                _spread(p, k, i, j, w.section_damp, w.beam_damp)


@inlined
def _spread(p, k, i, j, given, out):
    """Write the block of nodes `i` and `j` of a tangent with respect to nodal coordinates into `out` (G, 81).

    `given` (G, 16) is the tangent with respect to the state of the cross-section. In it, the bending moment depends on
    the curvature only, and no other force depends on the curvature.
    """
    shape_i, slope_i, shape_j, slope_j = p[k, i], p[k, NODES + i], p[k, j], p[k, NODES + j]
    first = 27 * i + 3 * j  # rows of nine columns
    both = slope_i * slope_j
    out[k, first] = both * given[k, 0]
    out[k, first + 1] = both * given[k, 1]
    out[k, first + 2] = slope_i * shape_j * given[k, 2]
    out[k, first + 9] = both * given[k, 4]
    out[k, first + 10] = both * given[k, 5]
    out[k, first + 11] = slope_i * shape_j * given[k, 6]
    out[k, first + 18] = shape_i * slope_j * given[k, 8]
    out[k, first + 19] = shape_i * slope_j * given[k, 9]
    out[k, first + 20] = shape_i * shape_j * given[k, 10] + both * given[k, 15]


@subkernel
def beam_values(top, w, out):
    """Write axial force, shear force, bending moment and strain energy of every element into `out` (E, 4).

    Requires the forces of the same state. Forces and moments are those in the middle of the element; in an element of
    three nodes they are the means of both cross-sections.
    """
    sections, stress = top.sections, w.section_stress
    for element in range(len(out)):
        for i in range(4):
            out[element, i] = 0.0
    for k in range(len(sections)):
        element = sections[k, SECTION.element]
        share = 1.0 / (sections[k, SECTION.node_count] - 1)  # an element has one cross-section fewer than nodes
        for i in range(3):
            out[element, i] += share * stress[k, i]
        out[element, 3] += w.section_energy[k, 0]


@subkernel
def beam_levels(top, w):
    """Return the largest accelerations (linear, angular) that individual terms of the forces of beams would cause.

    Forces of stiff beams are small differences of these terms and contain their rounding errors.
    """
    sections, p, z = top.sections, top.section_parameters, w.section
    level_t = level_r = 0.0
    for k in range(len(sections)):
        # terms are added with their absolute values, as if none of them cancelled
        stretch = abs(z[k, 0]) + abs(z[k, 1])
        rate = abs(z[k, 4]) + abs(z[k, 5]) + stretch * abs(z[k, 6])
        force = (p[k, 7] + p[k, 8]) * (stretch + abs(p[k, 10]) + abs(p[k, 11])) + (p[k, 13] + p[k, 14]) * rate
        turn = abs(p[k, 12])
        for i in range(sections[k, SECTION.node_count]):
            turn += abs(p[k, NODES + i])  # curvature if the angles of the nodes are of the order of 1 rad
        moment = p[k, 9] * turn + p[k, 15] * abs(z[k, 7])
        for i in range(sections[k, SECTION.node_count]):
            node, shape, slope = sections[k, SECTION.node + i], abs(p[k, i]), abs(p[k, NODES + i])
            level_t = max(level_t, p[k, 6] * slope * force * top.weight[node, 0])
            level_r = max(level_r, p[k, 6] * (shape * force * stretch + slope * moment) * top.weight[node, 2])
    return level_t, level_r
