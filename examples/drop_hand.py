"""Drop a hand on a table: `python examples/drop_hand.py`, or add `mujoco` for the other engine."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from raisim_like import World

HAND = Path(__file__).resolve().parents[1] / "data" / "free" / "hand" / "free_hand.urdf"


def main(engine: str = "pybullet") -> None:
    """Print the height of the palm and the force on the table every tenth of a second."""
    world = World(engine, timestep=0.002)
    world.set_default_material(0.8)
    table = world.add_box(1.0, 1.0, 0.05, mass=0.0)
    table.set_state((0, 0, 0.475))
    hand = world.add_articulated_system(HAND)
    hand.set_base_pose((0, 0, 0.75))
    # The wrist's three translations are free, so the hand falls; all rotations hold their pose.
    kp = np.where(np.arange(hand.dof) < 3, 0.0, 50.0)
    hand.set_pd_gains(kp, 0.2 * (kp > 0))
    for _ in range(8):
        world.integrate(50)
        down = sum(-c.impulse_W[2] for c in table.contacts()) / world.timestep
        height = hand.frame_pose("palm")[1][2] - 0.5
        print(f"{world.world_time:.1f} s: palm {1000 * height:4.0f} mm above the table, pressing with {down:4.1f} N")
    world.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
