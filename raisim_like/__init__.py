"""RaiSim's vocabulary over open physics engines. The package knows nothing about grasping."""

from raisim_like.articulated_system import ArticulatedSystem
from raisim_like.contact import Contact
from raisim_like.errors import EngineError, UrdfError
from raisim_like.rigid_body import RigidBody
from raisim_like.shapes import Shape
from raisim_like.urdf import UrdfModel, read_urdf
from raisim_like.world import World, integrate

__all__ = [
    "ArticulatedSystem",
    "Contact",
    "EngineError",
    "RigidBody",
    "Shape",
    "UrdfError",
    "UrdfModel",
    "World",
    "integrate",
    "read_urdf",
]
