"""The kernels that MuJoCo Warp's steps are surrounded with. Arrays have one row per world, contacts are of all worlds.

Without `from __future__ import annotations`, because Warp reads the annotations.
"""

import warp as wp

_Friction = wp.types.vector(length=5, dtype=float)


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
