"""HO3D's annotations, in the pickles of Python 2 and 3 that they come in."""

from __future__ import annotations

import collections
import gzip
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dgrasp.cli import main
from dgrasp.errors import DataError
from dgrasp.hand.free.skin import free_skin, skin_path
from dgrasp.hand.mano.params import wrist_joints
from dgrasp.hand.mano.skeleton import PARTS
from dgrasp.labels.formats.native import read_native_with_meta
from dgrasp.labels.recorded.ho3d import find_frames, read_annotation
from dgrasp.labels.recorded.skips import Skip
from dgrasp.types import Array
from tests.hand.mano_file import pickled
from tests.labels.mini_dexycb import MiniDexYcb, make_mini
from tests.labels.mini_hand import write_mini_hand


@pytest.fixture
def mini(tmp_path: Path) -> MiniDexYcb:
    return make_mini(tmp_path / "dex")[0]


def annotation(mini: MiniDexYcb, gap: float = 0.008, name: str = "004_sugar_box") -> dict[str, Any]:
    """A flat hand before the box of 0.04 m, turned as a whole: its middle fingertip, 0.1603 m away, at `gap` (m)."""
    R, t = Rotation.from_euler("xyz", [0.4, -1.0, 2.0]).as_matrix(), np.array([0.05, -0.1, -0.6])
    betas = np.full(10, 0.0)
    wrist = R @ np.array([0.02 + gap + 0.1603, 0.0, 0.0]) + t
    return {
        "handPose": np.concatenate([Rotation.from_matrix(R).as_rotvec(), np.zeros(45)]),
        "handTrans": wrist - wrist_joints(mini.model, betas[None])[0], "handBeta": betas,
        "objRot": Rotation.from_matrix(R).as_rotvec()[:, None], "objTrans": t.astype(np.float32), "objName": name,
        "objLabel": 4, "camMat": np.eye(3), "handVertContact": np.zeros(5, dtype=bool),
    }  # fmt: skip


def text_protocol(content: dict[str, Any]) -> bytes:
    """The dictionary as Python 2's first protocol writes it."""
    def quoted(raw: bytes) -> bytes:
        return b"'" + b"".join(b"\\x%02x" % byte for byte in raw) + b"'"

    def value(v: Any) -> bytes:
        if isinstance(v, np.ndarray):
            shape = b"(" + b"".join(b"I%d\n" % n for n in v.shape) + b"t"
            order = b"|" if v.dtype.itemsize == 1 else b"<"
            return (b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I0\ntS'b'\ntR(I1\n" + shape
                    + b"cnumpy\ndtype\n(S'" + v.dtype.str[1:].encode() + b"'\nI0\nI1\ntR(I3\nS'" + order
                    + b"'\nNNNI-1\nI-1\nI0\ntbI00\nS" + quoted(v.tobytes()) + b"\ntb")
        return b"I%d\n" % v if isinstance(v, int) else b"S'" + v.encode() + b"'\n"

    items = b"".join(b"S'" + key.encode() + b"'\np%d\n" % i + value(v) + b"s" for i, (key, v) in
                     enumerate(content.items()))
    return b"(dp100\n" + items + b"."


FORMS = {"python 2": pickled, "python 2, text": text_protocol, "python 3": lambda c: pickle.dumps(c, 3),
         "python 3.8": lambda c: pickle.dumps(c, 4), "protocol 0": lambda c: pickle.dumps(c, 0),
         "protocol 5": lambda c: pickle.dumps(c, 5),
         "other names": lambda c: pickle.dumps(collections.OrderedDict({**c, "objName": np.str_(c["objName"])}), 4),
         "bytes": lambda c: gzip.compress(pickle.dumps({**c, "objName": c["objName"].encode()}, 2))}


@pytest.mark.parametrize("form", FORMS)
def test_annotations_of_every_python(mini: MiniDexYcb, tmp_path: Path, form: str) -> None:
    content = annotation(mini)
    (tmp_path / "0.pkl").write_bytes(FORMS[form](content))
    found = read_annotation(tmp_path / "0.pkl")
    np.testing.assert_array_equal(found.params.pose[0], content["handPose"][3:])
    np.testing.assert_array_equal(found.params.transl[0], content["handTrans"])
    np.testing.assert_allclose(found.T_CO[:3, :3], Rotation.from_rotvec(content["objRot"][:, 0]).as_matrix())
    assert found.object == "004_sugar_box"


def write(mini: MiniDexYcb, place: str, content: dict[str, Any]) -> None:
    path = mini.root / place
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(pickled(content))


def test_labels_and_what_is_skipped(mini: MiniDexYcb, capsys: pytest.CaptureFixture[str]) -> None:
    for frame in range(4):
        write(mini, f"train/ABF10/meta/{frame:04d}.pkl", annotation(mini))
    write(mini, "train/BB11/meta/0000.pkl", annotation(mini, gap=0.03))
    write(mini, "train/BB12/meta/0000.pkl", {**annotation(mini), "handPose": None})
    write(mini, "train/BB13/meta/0000.pkl", {**annotation(mini), "objRot": None})
    write(mini, "train/BB14/meta/0000.pkl", annotation(mini, name="004_sugar_bx"))
    write(mini, "evaluation/SM1/meta/0000.pkl", {"objName": "004_sugar_box", "handJoints3D": np.zeros(3)})
    hand, out = write_mini_hand(mini.root / "mini_hand.urdf", mini.model), mini.root / "out.npz"
    words = ["labels", "import", "ho3d", str(mini.root), "--mano", str(mini.root / "MANO_RIGHT.pkl"), "--hand",
             str(hand), "--out", str(out)]
    assert main([*words, "--every", "2"]) == 0
    labels, meta = read_native_with_meta(out)
    assert [label.source for label in labels] == ["ho3d:train/ABF10/0000", "ho3d:train/ABF10/0002"]
    # Whatever frame the camera has: in the object's, the flat hand stands along x.
    np.testing.assert_allclose(labels[0].T_WH[:3, :3], np.eye(3), atol=1e-6)
    np.testing.assert_allclose(labels[0].T_WH[:3, 3], [0.1883, 0.0, 0.0], atol=1e-6)
    np.testing.assert_array_equal(labels[0].T_WO, np.eye(4))
    assert not labels[0].on_table and labels[0].start is None
    assert [PARTS[i] for i in np.flatnonzero(labels[0].goal_contacts)] == ["middle_distal"]
    assert meta["provenance"]["skipped"] == {
        "train/BB11/0000": "hand does not touch the object", "train/BB12/0000": "hand not annotated",
        "train/BB13/0000": "object not annotated", "train/BB14/0000": "damaged or missing file",
        "evaluation/SM1/0000": "hand not annotated",
    }  # fmt: skip
    assert "did you mean '004_sugar_box'" in capsys.readouterr().out
    assert len(find_frames(mini.root / "train", 1)) == 8
    assert main([*words, "--every", "0"]) == 2
    assert main(["labels", "import", "ho3d", "/nowhere", *words[4:]]) == 2
    assert "no HO3D here" in capsys.readouterr().err


def test_the_free_skin_has_fewer_shapes(mini: MiniDexYcb, capsys: pytest.CaptureFixture[str]) -> None:
    content = annotation(mini)
    mean = np.zeros((1, 6))
    content["handTrans"] += (wrist_joints(mini.model, mean) - wrist_joints(free_skin(), mean))[0]
    write(mini, "train/A/meta/0000.pkl", content)
    write(mini, "train/B/meta/0000.pkl", {**content, "handBeta": np.full(10, 0.5)})
    assert main(["labels", "import", "ho3d", str(mini.root), "--mano", str(skin_path()), "--hand", "free", "--every",
                 "1", "--out", str(mini.root / "out.npz"), "--objects", str(mini.root / "models")]) == 0
    labels, meta = read_native_with_meta(mini.root / "out.npz")
    assert [label.source for label in labels] == ["ho3d:train/A/0000"]
    assert meta["provenance"]["skipped"] == {"train/B/0000": "shape of another hand model"}
    assert "the MANO file has 6" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"handPose": np.zeros(45)}, "handPose is not 48 finite numbers"),
        ({"handPose": np.full(48, np.nan)}, "handPose is not 48"),
        ({"handPose": np.full(48, 90.0)}, "angle beyond 2 pi"),
        ({"objTrans": np.full(3, 600.0)}, "objTrans lies beyond 10 m"),
        ({"objRot": "x"}, "objRot is not 3"),
        ({"objName": 4}, "objName is no text"),
    ],
)
def test_bad_annotations(mini: MiniDexYcb, tmp_path: Path, change: dict[str, Array], message: str) -> None:
    (tmp_path / "0.pkl").write_bytes(pickled(annotation(mini) | change))
    with pytest.raises(DataError, match=message):
        read_annotation(tmp_path / "0.pkl")
    (tmp_path / "0.pkl").write_bytes(pickled([1, 2]))
    with pytest.raises(DataError, match="holds a list"):
        read_annotation(tmp_path / "0.pkl")
    (tmp_path / "0.pkl").write_bytes(pickled({"handPose": None}))
    with pytest.raises(Skip):
        read_annotation(tmp_path / "0.pkl")
