"""Read RaiSim-style URDFs: links may be massless, and fixed joints are collapsed into their parents."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from raisim_like.errors import UrdfError
from raisim_like.mimic import Mimic, Ties, resolve_mimics
from raisim_like.rotations import matrix_from_quaternion, quaternion_from_matrix, transform
from raisim_like.shapes import Shape
from raisim_like.urdf_gaps import fill_gaps

Array = NDArray[Any]


@dataclass(frozen=True)
class UrdfLink:
    """A moving link after collapsing: its joint, its parent and what is fixed to it.

    parent: index of the parent link, -1 for the base. kind: "revolute" or "prismatic".
    origin: (4, 4) joint frame in the parent link's frame. axis: (3,) unit, in the joint frame.
    mass kg, com (3,) m in the link frame, inertia (3, 3) kg m^2 about the com, axes of the link.
    mimic: the joint that this one follows, if any.
    """

    name: str
    joint: str
    parent: int
    kind: str
    origin: Array
    axis: Array
    lower: float
    upper: float
    damping: float
    mass: float
    com: Array
    inertia: Array
    shapes: tuple[Shape, ...]
    mimic: Mimic | None = None


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """An articulated system: one moving link per joint, depth first in the file's order.

    Models are compared by identity.

    frames: name of every original link -> (index of its moving link, -1 for the base; its pose (4, 4) in that link).
    """

    name: str
    links: tuple[UrdfLink, ...]
    frames: dict[str, tuple[int, Array]]
    path: Path

    @property
    def dof(self) -> int:
        """Number of joints. Those that follow others count too."""
        return len(self.links)

    @cached_property
    def ties(self) -> Ties:
        """The joints that follow others."""
        return Ties.of([link.mimic for link in self.links])

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Joint names in the order of the generalised coordinates."""
        return tuple(link.joint for link in self.links)

    @property
    def joint_limits(self) -> Array:
        """(dof, 2) lower and upper limits, rad or m."""
        return np.array([[link.lower, link.upper] for link in self.links])

    @property
    def joint_damping(self) -> Array:
        """(dof,) viscous damping from the file, N m s/rad or N s/m."""
        return np.array([link.damping for link in self.links])

    @property
    def mass(self) -> float:
        """Total mass of the moving links, kg."""
        return sum(link.mass for link in self.links)


def _rpy_matrix(rpy: Array) -> Array:
    """URDF's fixed-axis roll, pitch, yaw: R = Rz(y) Ry(p) Rx(r)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise UrdfError(f"{path}: cannot be read ({error})") from None
        if "<!DOCTYPE" in text or "<!ENTITY" in text:
            raise UrdfError(f"{path}: expected a URDF without document type and entities; refused")
        # A declared XML version other than 1.0 is a common slip in RaiSim's files, and harmless.
        if text.lstrip().startswith("<?xml"):
            text = text.partition("?>")[2]
        try:
            self.root = ElementTree.fromstring(text)
        except ElementTree.ParseError as error:
            raise UrdfError(f"{path}: not valid XML ({error})") from None
        if self.root.tag != "robot":
            raise UrdfError(f"{path}: expected a <robot> element, found <{self.root.tag}>")

    def fail(self, where: str, what: str) -> UrdfError:
        return UrdfError(f"{self.path}: {where}: {what}")

    def numbers(self, text: str | None, n: int, where: str) -> Array:
        try:
            values = np.array([float(word) for word in (text or "").split()])
        except ValueError:
            values = np.empty(0)
        if values.shape != (n,) or not np.isfinite(values).all():
            raise self.fail(where, f"expected {n} numbers, got {text!r}")
        return values

    def origin(self, element: ElementTree.Element | None, where: str) -> Array:
        node = None if element is None else element.find("origin")
        if node is None:
            return np.eye(4)
        xyz = self.numbers(node.get("xyz", "0 0 0"), 3, f"{where} origin xyz")
        rpy = self.numbers(node.get("rpy", "0 0 0"), 3, f"{where} origin rpy")
        return transform(_rpy_matrix(rpy), xyz)

    def shapes(self, link: ElementTree.Element, where: str) -> list[tuple[Shape, Array]]:
        found = []
        for collision in link.findall("collision"):
            T = self.origin(collision, f"{where} collision")
            geometry = collision.find("geometry")
            node = None if geometry is None or len(geometry) == 0 else geometry[0]
            if node is None:
                raise self.fail(where, "a <collision> without geometry")
            at = f"{where} {node.tag}"
            if node.tag == "box":
                shape = Shape("box", tuple(self.numbers(node.get("size"), 3, at)))
            elif node.tag in ("cylinder", "capsule"):
                size = self.numbers(f"{node.get('radius')} {node.get('length')}", 2, at)
                shape = Shape("cylinder" if node.tag == "cylinder" else "capsule", tuple(size))
            elif node.tag == "sphere":
                shape = Shape("sphere", tuple(self.numbers(node.get("radius"), 1, at)))
            elif node.tag == "mesh":
                file = self.path.parent / (node.get("filename") or "")
                if not file.is_file():
                    raise self.fail(at, f"mesh file {file} does not exist")
                x, y, z = (float(v) for v in self.numbers(node.get("scale", "1 1 1"), 3, f"{at} scale"))
                if min(abs(x), abs(y), abs(z)) == 0.0:
                    raise self.fail(at, f"scale {x:g} {y:g} {z:g}; expected three numbers other than zero")
                shape = Shape("hull", file=file, scale=(x, y, z))
            else:
                raise self.fail(at, "expected box, cylinder, capsule, sphere or mesh")
            if any(value <= 0 for value in shape.size):
                raise self.fail(at, f"sizes must be positive, got {shape.size}")
            found.append((shape, T))
        return found


def _place(shape: Shape, T: Array) -> Shape:
    x, y, z = (float(v) for v in T[:3, 3])
    w, i, j, k = (float(v) for v in quaternion_from_matrix(T[:3, :3]))
    return Shape(shape.kind, tuple(float(v) for v in shape.size), (x, y, z), (w, i, j, k), shape.file, shape.scale)


def _merge_inertias(items: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Mass, com and inertia of rigidly joined bodies (parallel-axis theorem)."""
    mass = sum(m for m, _, _ in items)
    if mass <= 0:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    com = sum((m * c for m, c, _ in items), start=np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for m, c, local in items:
        d = c - com
        inertia += local + m * (d @ d * np.eye(3) - np.outer(d, d))
    return mass, com, inertia


def read_urdf(path: Path | str) -> UrdfModel:
    """The moving links of a URDF file, in RaiSim's depth-first order.

    Fixed joints are collapsed: shapes and masses move to the nearest moving ancestor. A link with shapes and without
    <inertial> gets the mass and inertia of its shapes, with a warning that names it. A joint with <mimic> follows
    another one (`mimic`). Raises `UrdfError`.
    """
    reader = _Reader(Path(path))
    links: dict[str, ElementTree.Element] = {}
    for element in reader.root.findall("link"):
        name = element.get("name") or ""
        if not name or name in links:
            raise reader.fail("link", f"name {name!r} is missing or used twice")
        links[name] = element
    children: dict[str, list[ElementTree.Element]] = {name: [] for name in links}
    has_parent: set[str] = set()
    for joint in reader.root.findall("joint"):
        where = f"joint {joint.get('name')!r}"
        names = [node.get("link") if (node := joint.find(tag)) is not None else None for tag in ("parent", "child")]
        if names[0] not in links or names[1] not in links:
            raise reader.fail(where, f"parent or child link {names} is not in the file")
        if names[1] in has_parent:
            raise reader.fail(where, f"link {names[1]!r} has two parents")
        has_parent.add(str(names[1]))
        children[str(names[0])].append(joint)
    roots = [name for name in links if name not in has_parent]
    if len(roots) != 1:
        raise reader.fail("robot", f"expected one root link, found {roots}")

    moving: list[dict[str, Any]] = []
    frames: dict[str, tuple[int, Array]] = {}

    def attach(name: str, index: int, T: Array) -> None:
        """Attach the shapes and masses of link `name` to moving link `index` at pose T, then visit its children."""
        frames[name] = (index, T)
        element, where = links[name], f"link {name!r}"
        if index >= 0:
            target = moving[index]
            for shape, local in reader.shapes(element, where):
                target["shapes"].append(_place(shape, T @ local))
            inertial = element.find("inertial")
            if inertial is not None:
                target["inertials"].append(_inertial(reader, inertial, T, where))
        for joint in children[name]:
            _walk_joint(joint, index, T)

    def _walk_joint(joint: ElementTree.Element, index: int, T: Array) -> None:
        where = f"joint {joint.get('name')!r}"
        kind = joint.get("type")
        child = joint.find("child").get("link")  # type: ignore[union-attr]
        here = T @ reader.origin(joint, where)
        if kind == "fixed":
            attach(str(child), index, here)
            return
        if kind not in ("revolute", "continuous", "prismatic"):
            raise reader.fail(where, f"type {kind!r}; expected fixed, revolute, continuous or prismatic")
        axis_node, limit, dynamics = joint.find("axis"), joint.find("limit"), joint.find("dynamics")
        axis = reader.numbers("1 0 0" if axis_node is None else axis_node.get("xyz"), 3, f"{where} axis")
        if np.linalg.norm(axis) < 1e-9:
            raise reader.fail(where, "axis has no length")
        lower, upper = -np.inf, np.inf
        if limit is not None and kind != "continuous":
            lower, upper = reader.numbers(f"{limit.get('lower', 0)} {limit.get('upper', 0)}", 2, f"{where} limit")
        if lower > upper:
            raise reader.fail(where, f"lower limit {lower} above upper limit {upper}")
        damping = 0.0 if dynamics is None else reader.numbers(dynamics.get("damping", "0"), 1, f"{where} damping")[0]
        if damping < 0:
            raise reader.fail(where, f"negative damping {damping}")
        moving.append(
            {
                "name": str(child),
                "joint": str(joint.get("name")),
                "parent": index,
                "kind": "prismatic" if kind == "prismatic" else "revolute",
                "origin": here,
                "axis": axis / np.linalg.norm(axis),
                "lower": float(lower),
                "upper": float(upper),
                "damping": float(damping),
                "shapes": [],
                "inertials": [],
            }
        )
        attach(str(child), len(moving) - 1, np.eye(4))

    try:
        attach(roots[0], -1, np.eye(4))
    except RecursionError:
        raise reader.fail("robot", "links are nested too deeply") from None
    if len(frames) != len(links):
        raise reader.fail("robot", f"links not connected to {roots[0]!r}: {sorted(set(links) - set(frames))}")
    fill_gaps(reader.path, moving)
    resolve_mimics(moving, reader.root.findall("joint"), reader.fail, reader.numbers)
    built = []
    for entry in moving:
        mass, com, inertia = _merge_inertias(entry.pop("inertials"))
        shapes = tuple(entry.pop("shapes"))
        built.append(UrdfLink(mass=mass, com=com, inertia=inertia, shapes=shapes, **entry))
    return UrdfModel(str(reader.root.get("name", "robot")), tuple(built), frames, Path(path))


def _inertial(reader: _Reader, node: ElementTree.Element, T: Array, where: str) -> tuple[float, Array, Array]:
    mass_node, inertia_node = node.find("mass"), node.find("inertia")
    mass = float(reader.numbers(None if mass_node is None else mass_node.get("value"), 1, f"{where} mass")[0])
    if mass < 0:
        raise reader.fail(where, f"negative mass {mass}")
    local = np.zeros((3, 3))
    if inertia_node is not None:
        keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
        xx, xy, xz, yy, yz, zz = reader.numbers(
            " ".join(inertia_node.get(k, "0") for k in keys), 6, f"{where} inertia"
        )
        local = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    placed = T @ reader.origin(node, f"{where} inertial")
    R = placed[:3, :3]
    return mass, placed[:3, 3], R @ local @ R.T if mass > 0 else np.zeros((3, 3))


def shape_pose(shape: Shape) -> Array:
    """(4, 4) pose of a shape in its body's frame."""
    return transform(matrix_from_quaternion(np.array(shape.quaternion)), np.array(shape.position))
