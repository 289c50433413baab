"""Figures of labels on bodies of known size, and the command's words, table and page."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from dgrasp.cli import main
from dgrasp.files.paths import data_root
from dgrasp.geometry.intersection import Body, body
from dgrasp.geometry.shape_mesh import shape_mesh
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.hand.spheres import HandSpheres
from dgrasp.labels.formats.native import read_native, write_native
from dgrasp.labels.quality.measure import Finding, duplicates, measure_labels
from dgrasp.labels.quality.weight import Carrying
from dgrasp.objects.body import object_body
from dgrasp.objects.free import free_object
from dgrasp.types import Array, GraspLabel, StartPose
from raisim_like.rotations import matrix_from_euler, transform
from raisim_like.shapes import Shape
from tests.scenes import free_hand

HAND = free_hand()
BOX = body([shape_mesh(Shape("box", (0.04, 0.06, 0.10)))])


class Cube:
    """A hand's surface that is one cube of 2 cm around the wrist."""

    kind = "cube"

    def pieces(self, T_AH: Array, hand_pose: Array) -> list[Body]:
        return [body([shape_mesh(Shape("box", (0.02, 0.02, 0.02)))]).placed(T_AH)]


def label(wrist_O: tuple[float, float, float], height: float = 0.55, start_height: float | None = None,
          pose: Array | None = None, turn: float = 0.0, index: int = 0) -> GraspLabel:  # fmt: skip
    """A hand at `wrist_O` of an object whose origin is at `height`, all turned about z by `turn`."""
    R = matrix_from_euler(np.array([0.0, 0.0, turn]))
    T_WO = transform(R, np.array([0.6, 0.0, height]))
    T_WH = T_WO @ transform(np.eye(3), np.array(wrist_O))
    angles = np.zeros(45) if pose is None else pose
    gc = np.zeros((1, 51))
    gc[0, 6:] = angles
    joints = HAND.forward(gc, T_WH[None, :3, :3], T_WH[None, :3, 3])[1][0]
    start = None
    if start_height is not None:
        start = StartPose(T_WH, transform(R, np.array([0.6, 0.0, start_height])), angles)
    return GraspLabel("box", angles, T_WH, T_WO, joints, np.arange(16) < 3, start, "free", "s", index, True)


def measured(*labels: GraspLabel) -> list[Finding]:
    # Each alone, for many of them are the same grasp at another height.
    return [measure_labels([one], HAND, Cube(), {"box": BOX})[0] for one in labels]


def test_help_says_that_nothing_is_simulated(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["labels", "check", "--help"])
    shown = capsys.readouterr().out
    assert "nothing is simulated" in shown and "--engine E" not in shown


def test_penetration_and_distance_by_hand() -> None:
    # The box ends at x = 20 mm. A cube around 25 mm reaches from 15 to 35: 5 x 20 x 20 mm inside. Around 40 mm: 10 mm
    # away. Around (50, 70, 0): 20 mm in x and 30 mm in y.
    inside, away, corner = measured(label((0.025, 0, 0)), label((0.04, 0, 0), turn=0.7), label((0.05, 0.07, 0)))
    assert inside.penetration_cm3 == pytest.approx(2.0, abs=1e-4) and inside.distance_mm == 0.0
    assert away.penetration_cm3 == 0.0 and away.distance_mm == pytest.approx(10.0, abs=1e-3)
    assert corner.distance_mm == pytest.approx(np.hypot(20.0, 30.0), abs=1e-3)
    assert away.problems == [] and corner.problems == ["hand 36 mm from the object"]
    assert corner.badness > away.badness


def test_the_table() -> None:
    # The box's lowest point is 50 mm below its origin, the table's top at 0.5 m.
    sound, low, high, lifted = measured(
        label((0.025, 0, 0)), label((0.025, 0, 0), height=0.53), label((0.025, 0, 0), start_height=0.58),
        label((0.025, 0, 0), height=0.60, start_height=0.55),
    )  # fmt: skip
    assert sound.table_mm == pytest.approx(0.0, abs=1e-6) and sound.problems == []
    assert low.table_mm == pytest.approx(-20.0, abs=1e-6) and low.problems == ["object 20 mm under the table"]
    assert high.problems == ["object 30 mm over the table"]
    # Where it is at the grasp does not matter, unless it is under the table.
    assert lifted.problems == []
    (sunk,) = measured(label((0.025, 0, 0), height=0.53, start_height=0.55))
    assert sunk.problems == ["object 20 mm under the table at the grasp"]
    (free,) = measured(dataclasses.replace(label((0.025, 0, 0), height=0.0), on_table=False))
    assert free.table_mm is None and free.problems == []


def test_an_object_beside_the_table() -> None:
    one = label((0.025, 0, 0))
    for x, y, beside in ((0.24, 0.0, True), (0.26, 0.49, False), (2.26, 0.0, True), (0.6, -0.51, True)):
        moved = np.array([x - 0.6, y, 0.0])
        T_WH, T_WO = one.T_WH.copy(), one.T_WO.copy()
        T_WH[:3, 3] += moved
        T_WO[:3, 3] += moved
        there = dataclasses.replace(one, T_WH=T_WH, T_WO=T_WO, joints_W=one.joints_W + moved)
        assert ("object beside the table" in measured(there)[0].problems) == beside
        assert not measured(dataclasses.replace(there, on_table=False))[0].beside


def test_what_stands_on_the_table_is_what_is_simulated() -> None:
    # 20 mm longer than the surface at both ends.
    longer = {"box": np.array([[0.02, 0.03, 0.07], [-0.02, -0.03, -0.07]])}
    (finding,) = measure_labels([label((0.025, 0, 0))], HAND, Cube(), {"box": BOX}, simulated=longer)
    assert finding.table_mm == pytest.approx(-20.0, abs=1e-6)
    assert finding.penetration_cm3 == pytest.approx(2.0, abs=1e-4)


def test_a_hand_that_would_be_under_the_table() -> None:
    # Over the object at the grasp, which lies upside down at its start.
    one = label((0.0, 0.0, 0.15))
    over = transform(matrix_from_euler(np.array([np.pi, 0.0, 0.0])), one.T_WO[:3, 3])
    (finding,) = measured(dataclasses.replace(one, start=StartPose(one.T_WH, over, one.hand_pose)))
    expected = 1000.0 * (one.joints_W[:, 2].max() - 0.55 - 0.05)
    assert finding.sunk_mm == pytest.approx(expected, abs=1e-6) and expected > 50.0
    assert f"hand {expected:.0f} mm under the table, at the object's start" in finding.problems
    assert measured(one)[0].sunk_mm == 0.0 and not any("start" in words for words in measured(one)[0].problems)


def test_what_touches_too_little_does_not_carry() -> None:
    labels = [one for one in read_native(data_root() / "free" / "labels" / "free_train.npz")
              if one.object_id == "004_sugar_box"][:6]  # fmt: skip
    model = free_object("004_sugar_box", "official", True)
    carrying = Carrying(HAND, {model.name: object_body(model, Path()).body}, {model.name: model.center_of_mass_O})
    assert all(carrying.carries(one) for one in labels)
    for one in labels:
        # 10 cm off the box.
        away = one.T_WH[:3, 3] - one.T_WO[:3, 3]
        back = one.T_WH.copy()
        back[:3, 3] += 0.10 * away / np.linalg.norm(away)
        assert not carrying.carries(dataclasses.replace(one, T_WH=back))
    # A weight metres beside the box, which 20 weights of force do not balance.
    beside = Carrying(HAND, {model.name: object_body(model, Path()).body}, {model.name: np.full(3, 3.0)})
    assert not any(beside.carries(one) for one in labels)
    # Of a label without a table nobody knows which way is down.
    free = dataclasses.replace(labels[0], T_WH=back, on_table=False)
    bodies = {model.name: object_body(model, Path()).body}
    assert measure_labels([free], HAND, Cube(), bodies, carrying=carrying)[0].carries


def test_the_far_side_of_a_thin_wall_is_not_touched() -> None:
    # An upright plate, 3 mm thick, and a hand 1 mm beside it: if its other side counted, it would be pinched.
    carrying = Carrying(HAND, {"box": body([shape_mesh(Shape("box", (0.003, 0.6, 0.6)))])}, {"box": np.zeros(3)})
    spheres = HandSpheres.of_hand(HAND)
    at_rest = spheres.place(*HAND.part_poses(np.eye(4)[None], np.zeros((1, 45))))[0]
    nearest = float((at_rest[:, 0] - spheres.radii).min())
    assert not carrying.carries(label((0.0015 + 0.001 - nearest, 0.0, 0.0)))


def test_a_hull_that_is_pressed_in_deeply_touches() -> None:
    # Points of hulls have no radius; between them is the hand.
    carrying = Carrying(HAND, {"box": body([shape_mesh(Shape("box", (0.2, 0.2, 0.2)))])}, {"box": np.zeros(3)})
    corners = np.array([[x, y, z] for x in (-0.01, 0.01) for y in (-0.01, 0.01) for z in (-0.05, 0.05)])
    carrying._spheres = HandSpheres(corners, np.zeros(8), np.zeros(8, int), 16)
    points = np.array([[0.0, 0.0, 0.0], [0.02, 0.0, 0.0]])
    assert carrying._pressed(points, corners, np.full(2, np.inf)).tolist() == [True, False]


def test_limits_frames_and_contacts() -> None:
    pose = np.zeros(45)
    pose[3] = HAND.limits[9, 1] + np.deg2rad(20.0)
    bent = label((0.025, 0, 0), pose=pose)
    (finding,) = measured(bent)
    assert finding.beyond_limits == 1 and finding.limit_excess_deg == pytest.approx(20.0)
    assert finding.problems == ["joint 20 degrees beyond its limit"]
    # Key points of a hand turned about its wrist by 0.1 rad: a fingertip 0.17 m away is off by 17 mm.
    turned = label((0.025, 0, 0))
    R = matrix_from_euler(np.array([0.0, 0.1, 0.0]))
    joints = (turned.joints_W - turned.T_WH[:3, 3]) @ R.T + turned.T_WH[:3, 3]
    (finding,) = measured(dataclasses.replace(turned, joints_W=joints, goal_contacts=np.zeros(16, bool)))
    far = np.linalg.norm(turned.joints_W - turned.T_WH[:3, 3], axis=1).max()
    assert 5.0 < finding.off_mm <= 100.0 * far + 1.0
    assert finding.problems[1:] == ["no goal contacts"] and "key points" in finding.problems[0]


def test_duplicates() -> None:
    first, turned = label((0.025, 0, 0)), label((0.025, 0, 0), turn=1.0, height=0.7, index=1)
    other, near = label((0.0275, 0, 0), index=2), label((0.0255, 0, 0), index=3)
    # The same hand on the same object, wherever both stand; 0.5 mm are the same, 2.5 mm are not.
    assert duplicates([first, turned, other, near]) == {1: first.name, 3: first.name}
    assert duplicates([first, dataclasses.replace(turned, object_id="other")]) == {}


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    labels = read_native(data_root() / "free" / "labels" / "free_train.npz")
    chosen = [one for one in labels if one.object_id in ("004_sugar_box", "061_foam_brick") and one.index < 2]
    lifted = chosen[0].T_WO.copy()
    lifted[2, 3] += 1.0
    chosen.append(dataclasses.replace(chosen[0], T_WO=lifted, index=7))
    write_native(tmp_path / "a.npz", chosen, "p", "CC0 <b>", MANO_NAMES)
    assert main(["labels", "check", str(tmp_path / "a.npz"), "--data", "free", "--html"]) == 0
    shown = capsys.readouterr().out
    assert "5 labels of 2 objects: 5 with an approach, 5 with a table" in shown
    assert "1 cannot carry the object's weight with their contacts; 0 duplicates" in shown
    assert "1 labels with problems" in shown and "004_sugar_box[7]: hand 500 mm from the object" in shown
    page = (tmp_path / "a.html").read_text()
    # The worst comes first, every label has a picture, and text is escaped.
    assert page.count("<img") == 5 and page.index("[7]</b>") < min(page.index(f"[{i}]</b>") for i in (0, 1))
    assert "CC0 &lt;b&gt;" in page and "<b>\"" not in page
    assert main(["labels", "check", str(tmp_path / "b.npz"), "--data", "free"]) == 2
    assert main(["labels", "check", str(tmp_path / "a.npz"), "--data", "free", "--shapes"]) == 2
    assert "--shapes: only valid with --html" in capsys.readouterr().err
    assert main(["labels", "check", str(tmp_path / "a.npz"), "--html", str(tmp_path / "no" / "x.html")]) == 2
