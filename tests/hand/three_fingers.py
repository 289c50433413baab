"""A made-up hand that is no human one: a palm with three fingers of one, two and three joints, one axis each."""

from __future__ import annotations

from pathlib import Path

BONE = '<inertial><origin xyz="{x} {y} 0"/><mass value="{mass}"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5"/></inertial>'


def _link(name: str, length: float, along: tuple[float, float], turned: str) -> str:
    """A finger part: a capsule of that length (m) from its joint along a direction (x, y)."""
    x, y = (length / 2 * part for part in along)
    return (f'<link name="{name}">{BONE.format(x=x, y=y, mass=0.03)}<collision><origin xyz="{x} {y} 0" rpy="{turned}"/>'
            f'<geometry><capsule radius="0.009" length="{length - 0.01}"/></geometry></collision></link>')


def _joint(name: str, parent: str, child: str, place: str, axis: str, limits: tuple[float, float]) -> str:
    return (f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<origin xyz="{place}" rpy="0 0 0"/><axis xyz="{axis}"/><limit lower="{limits[0]}" upper="{limits[1]}"/>'
            '<dynamics damping="1.0"/></joint>')


def write_three_fingers(path: Path) -> Path:
    """Write its URDF.

    The palm looks along -y. Two fingers point along -x and close towards -y; the thumb, between them and the wrist,
    points along -y and closes towards them.
    """
    lines = ['<robot name="three"><link name="base"/>']
    above = "base"
    for kind, word, damping in (("prismatic", "t", 10), ("revolute", "r", 1)):
        for axis, direction in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True):
            link = "palm" if (kind, axis) == ("revolute", "z") else f"wrist_{word}{axis}_link"
            lines.append(f'<joint name="wrist_{word}{axis}" type="{kind}"><parent link="{above}"/>'
                         f'<child link="{link}"/><axis xyz="{direction}"/><limit lower="-10" upper="10"/>'
                         f'<dynamics damping="{damping}"/></joint>')
            if link != "palm":
                lines.append(f'<link name="{link}"/>')
            above = link
    lines.append(f'<link name="palm">{BONE.format(x=-0.04, y=0.0, mass=0.3)}<collision><origin xyz="-0.04 0 0"/>'
                 '<geometry><box size="0.08 0.02 0.07"/></geometry></collision></link>')
    out, quarter = (-1.0, 0.0), "0 1.5707963 0"
    for finger, z, lengths in (("long", 0.022, (0.04, 0.035, 0.03)), ("short", -0.022, (0.05, 0.045))):
        above, place = "palm", f"-0.08 0 {z}"
        for k, length in enumerate(lengths):
            name = f"{finger}_{k}"
            lines += [_link(name, length, out, quarter),
                      _joint(f"{name}_joint", above, name, place, "0 0 1", (-0.1, 1.6))]
            above, place = name, f"{-length} 0 0"
        lines.append(f'<link name="{finger}_tip"/><joint name="{finger}_end" type="fixed"><parent link="{above}"/>'
                     f'<child link="{finger}_tip"/><origin xyz="{place}"/></joint>')
    lines += [_link("thumb_0", 0.075, (0.0, -1.0), "1.5707963 0 0"),
              _joint("thumb_0_joint", "palm", "thumb_0", "-0.02 -0.01 0", "0 0 -1", (-0.3, 0.9))]
    path.write_text("\n".join([*lines, "</robot>"]), encoding="utf-8")
    return path


def write_tied_fingers(path: Path) -> Path:
    """The same hand, in which each finger has one motor: its outer joints follow the one before by 0.9 q + 0.1."""
    text = write_three_fingers(path).read_text("utf-8")
    for leader, follower in (("long_0", "long_1"), ("long_1", "long_2"), ("short_0", "short_1")):
        child = f'<child link="{follower}"/>'
        text = text.replace(child, f'{child}<mimic joint="{leader}_joint" multiplier="0.9" offset="0.1"/>', 1)
    path.write_text(text, encoding="utf-8")
    return path
