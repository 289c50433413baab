"""Errors of the physics layer."""


class UrdfError(ValueError):
    """A URDF that cannot be read; the message names file, element and what was expected."""


class EngineError(RuntimeError):
    """A request that the physics engine cannot carry out."""
