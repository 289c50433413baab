"""The kernels that MuJoCo Warp's steps are surrounded with. Arrays have one row per world, contacts are of all worlds.

Without `from __future__ import annotations`, because Warp reads the annotations.
"""

import warp as wp

_Friction = wp.types.vector(length=5, dtype=float)
CYLINDER = wp.constant(5)
BOX = wp.constant(6)
"""MuJoCo's numbers of these kinds of geoms."""
NEARLY = wp.constant(0.999)
"""Cosine of the angle below which two directions count as the same."""


@wp.kernel(enable_backward=False)
def keep_closed(
    timestep: wp.array[float],
    count: wp.array[int],
    world: wp.array[int],
    friction: wp.array[_Friction],
    address: wp.array2d[int],
    velocity: wp.array2d[float],
    target: wp.array2d[float],
) -> None:
    """Lower the target of each sliding contact's normal direction (docs/physics.md, "Sliding contacts stay closed").

    address: rows of the normal and the tangents in velocity and target (N, rows); -1 for a contact without force.
    """
    i = wp.tid()
    if i < count[0] and address[i, 0] >= 0:
        w = world[i]
        first = velocity[w, address[i, 1]]
        second = velocity[w, address[i, 2]]
        speed = wp.sqrt(first * first + second * second)
        target[w, address[i, 0]] -= friction[i][0] * speed / timestep[w % timestep.shape[0]]


@wp.kernel(enable_backward=False)
def lay_cylinders(
    count: wp.array[int],
    world: wp.array[int],
    geoms: wp.array[wp.vec2i],
    dimension: wp.array[int],
    kind: wp.array[int],
    size: wp.array2d[wp.vec3],
    centre: wp.array2d[wp.vec3],
    turn: wp.array2d[wp.mat33],
    position: wp.array[wp.vec3],
    distance: wp.array[float],
    frame: wp.array[wp.mat33],
) -> None:
    """Replace the contacts of cylinders that lie on boxes by exact ones (docs/physics.md, "MuJoCo Warp").

    Single precision finds them up to 1.5 mm beside the axis, and the cylinder would roll away. Contacts with rolling
    friction (dimension 6) are those of bodies that turn easily. size, centre, turn: of the geoms, (N or 1, ngeom).
    """
    i = wp.tid()
    if i >= count[0] or dimension[i] != 6:
        return
    w = world[i]
    cylinder = geoms[i][0]
    box = geoms[i][1]
    sign = -1.0
    if kind[cylinder] != CYLINDER:
        cylinder = geoms[i][1]
        box = geoms[i][0]
        sign = 1.0
    if kind[cylinder] != CYLINDER or kind[box] != BOX:
        return
    found = wp.vec3(frame[i][0, 0], frame[i][0, 1], frame[i][0, 2]) * sign
    face = 0
    normal = wp.vec3(0.0, 0.0, 0.0)
    for k in range(3):
        side = wp.vec3(turn[w, box][0, k], turn[w, box][1, k], turn[w, box][2, k])
        if wp.abs(wp.dot(side, found)) > NEARLY:
            face = k
            normal = side * wp.sign(wp.dot(side, found))
    axis = wp.vec3(turn[w, cylinder][0, 2], turn[w, cylinder][1, 2], turn[w, cylinder][2, 2])
    down = wp.dot(normal, axis) * axis - normal
    # Not on a face of the box, or not on the side of the cylinder.
    if wp.length(down) < NEARLY:
        return
    row = size.shape[0]
    along = wp.dot(position[i] - centre[w, cylinder], axis)
    lowest = centre[w, cylinder] + along * axis + size[w % row, cylinder][0] * wp.normalize(down)
    gap = wp.dot(lowest - centre[w, box], normal) - size[w % row, box][face]
    old = wp.vec3(frame[i][1, 0], frame[i][1, 1], frame[i][1, 2])
    first = wp.normalize(old - wp.dot(old, normal) * normal)
    n = normal * sign
    second = wp.cross(n, first)
    position[i] = lowest - 0.5 * gap * normal
    distance[i] = gap
    frame[i] = wp.mat33(
        n[0], n[1], n[2], first[0], first[1], first[2], second[0], second[1], second[2]
    )


@wp.kernel(enable_backward=False)
def add_forces(
    active: wp.array[int],
    count: wp.array[int],
    world: wp.array[int],
    geoms: wp.array[wp.vec2i],
    address: wp.array2d[int],
    force: wp.array2d[float],
    link_of: wp.array[int],
    body_of: wp.array[int],
    on_links: wp.array3d[float],
    between: wp.array3d[float],
) -> None:
    """Add the normal force (N) of each contact of the active worlds to those between its bodies.

    link_of, body_of: (ngeom,) coordinate of a link's joint, number of a rigid body; -1 for others. on_links:
    (N, dof, B). between: (N, B, B).
    """
    i = wp.tid()
    if i < count[0] and address[i, 0] >= 0:
        w = world[i]
        if active[w] != 0:
            f = force[w, address[i, 0]]
            a = geoms[i][0]
            b = geoms[i][1]
            if link_of[a] >= 0 and body_of[b] >= 0:
                wp.atomic_add(on_links, w, link_of[a], body_of[b], f)
            if link_of[b] >= 0 and body_of[a] >= 0:
                wp.atomic_add(on_links, w, link_of[b], body_of[a], f)
            if body_of[a] >= 0 and body_of[b] >= 0:
                wp.atomic_add(between, w, body_of[a], body_of[b], f)
                wp.atomic_add(between, w, body_of[b], body_of[a], f)


@wp.kernel(enable_backward=False)
def zero_rows(chosen: wp.array[int], array: wp.array2d[float]) -> None:
    """Write zeros into the chosen rows of an array (N, K)."""
    w, k = wp.tid()
    if chosen[w] != 0:
        array[w, k] = 0.0


@wp.kernel(enable_backward=False)
def zero_blocks(chosen: wp.array[int], array: wp.array3d[float]) -> None:
    """Write zeros into the chosen rows of an array (N, K, L)."""
    w, k, j = wp.tid()
    if chosen[w] != 0:
        array[w, k, j] = 0.0


@wp.kernel(enable_backward=False)
def put_back(active: wp.array[int], saved: wp.array2d[float], array: wp.array2d[float]) -> None:
    """Write the saved values into the rows of an array (N, K) that are not active."""
    w, k = wp.tid()
    if active[w] == 0:
        array[w, k] = saved[w, k]
