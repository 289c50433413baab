"""The interface between `World` and an engine of single worlds. The engine names bodies by integer ids."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from numpy.typing import NDArray

from raisim_like.batch import Preset
from raisim_like.contact import Contact
from raisim_like.material import MaterialTable
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel

Array = NDArray[Any]

STRIDE: dict[Preset, int] = {"faithful": 1, "fast": 2}
"""Most timesteps that one engine step covers (docs/physics.md)."""


def engine_steps(substeps: int, timestep: float, preset: Preset) -> tuple[int, float]:
    """The number of equal engine steps that make up `substeps` timesteps, and the length (s) of one."""
    steps = -(-substeps // STRIDE[preset])
    # Multiplying and dividing would not always give back the timestep to the last bit.
    return steps, timestep if steps == substeps else timestep * substeps / steps


class EngineWorld(Protocol):
    """One simulated world of an engine."""

    timestep: float
    step_seconds: float
    """Wall-clock seconds spent in the engine's own step so far."""

    def close(self) -> None:
        """Free the world."""

    def set_gravity(self, gravity: Array) -> None:
        """Set gravity (3,), m/s^2, world frame."""

    def add_body(
        self, shapes: Sequence[Shape], mass: float, com: Array, inertia: Array, material: str, collision_mask: int
    ) -> int:
        """Add a rigid body; mass 0 makes it static. inertia (3, 3) about the com (3,)."""

    def add_articulated(
        self, model: UrdfModel, material: str, collision_mask: int, self_collision: bool, enforce_limits: bool
    ) -> int:
        """Add an articulated system on a fixed base."""

    def remove(self, body: int) -> None:
        """Remove a body from the world."""

    def apply_materials(self, table: MaterialTable) -> None:
        """Set the friction of all bodies."""

    def set_body_state(self, body: int, state: Array) -> None:
        """Set position 3, quaternion 4 (w x y z), linear 3 and angular velocity 3 of a body's frame, world."""

    def get_body_state(self, body: int, out: Array) -> None:
        """Write the (13,) state of `set_body_state` into out."""

    def set_base_pose(self, body: int, position: Array, quaternion: Array) -> None:
        """Set the pose of an articulated system's fixed base: position (3,) m, quaternion (4,) w x y z, world."""

    def set_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        """Set generalised coordinates and velocities (dof,), and reset the controller's memory."""

    def get_joint_state(self, body: int, gc: Array, gv: Array) -> None:
        """Write coordinates and velocities into (dof,) arrays."""

    def set_pd_gains(self, body: int, kp: Array, kd: Array) -> None:
        """Set the PD gains (dof,)."""

    def set_pd_target(self, body: int, target: Array) -> None:
        """Set the PD position target (dof,); the target velocity is zero."""

    def set_feed_forward(self, body: int, force: Array) -> None:
        """Set the generalised feed-forward force (dof,), N or N m."""

    def apply_wrench(self, body: int, force: Array, torque: Array) -> None:
        """Apply a force (3,) N at a rigid body's centre of mass and a torque (3,) N m, world, in the next substep only.

        Several calls add up.
        """

    def apply_generalized_force(self, body: int, force: Array) -> None:
        """Apply a force (dof,) to an articulated system in the next substep only; several calls add up."""

    def mass_matrix(self, body: int) -> Array:
        """(dof, dof) mass matrix of the articulated system as the engine simulates it."""

    def forget_contacts(self) -> None:
        """Drop the solver's memory of past contacts; all bodies must be placed anew afterwards."""

    def link_impulses(self, body: int, other: int, out: Array) -> None:
        """Write the summed normal impulse (N s, last substep) of each moving link against `other`, (dof,)."""

    def touching(self, body: int, other: int) -> bool:
        """Whether two bodies pressed on each other in the last substep."""

    def contacts(self, body: int) -> list[Contact]:
        """All contact points of a body."""

    def link_poses(self, body: int) -> tuple[Array, Array]:
        """World rotations (dof, 3, 3) and origins (dof, 3) of the moving links."""

    def bare_step(self, substeps: int) -> float:
        """Run only the engine's own step for `substeps` timesteps under the last torques.

        This is the baseline for the cost of control and reading. Returns the wall-clock seconds in that step.
        """

    def save(self) -> Any:
        """Everything that the next steps depend on, except gravity, materials and the set of bodies."""

    def restore(self, snapshot: Any) -> None:
        """Go back to a snapshot of this world, any number of times.

        Raises `EngineError` if bodies were added or removed since.
        """


class Engine(Protocol):
    """Makes worlds and integrates several of them together."""

    name: str

    def make_world(self, timestep: float, preset: Preset) -> EngineWorld:
        """A new empty world."""

    def integrate(self, worlds: Sequence[EngineWorld], substeps: int, threads: int = 1) -> None:
        """Advance all worlds by `substeps` timesteps, PD control included."""
