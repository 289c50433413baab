"""Find an object by the name that a user gives: an object that was added, or one of the 20."""

from __future__ import annotations

from pathlib import Path

from dgrasp.config.experiment import Config
from dgrasp.errors import DataError
from dgrasp.objects.model import ObjectModel
from dgrasp.objects.names import LARGE_CLAMP, resolve_object
from dgrasp.objects.store import StoredObject, default_store, find_object, load_object
from raisim_like.registry import CONCAVE_MESHES


def find_named(name: str, store: Path | None = None) -> StoredObject | str:
    """The added object of that name if there is one, else the full name of one of the 20.

    store: the folder of added objects; None is the default one. Raises `DataError` for an unknown object.
    """
    folder = store or default_store()
    if (folder / name).is_dir():
        return find_object(name, [folder])
    try:
        return resolve_object(name)
    except DataError:
        if name == LARGE_CLAMP:
            raise
        return find_object(name, [folder])


def build_named(found: StoredObject | str, data: Path | None, config: Config) -> ObjectModel:
    """The model of an added object, or of one of the 20. data: a folder like the authors' release; None is free."""
    from dgrasp.objects.free import free_object
    from dgrasp.objects.release import release_object

    physics, parts = config.physics, config.engine not in CONCAVE_MESHES
    authors = physics.authors_inertia(False)
    if not isinstance(found, str):
        return load_object(found.folder, authors, parts)
    if data is None:
        return free_object(found, physics.masses, authors)
    concave = "parts" if parts else physics.concave
    return release_object(data / "objects", found, physics.masses, physics.authors_inertia(True), concave)
