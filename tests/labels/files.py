"""Label files for tests: made up by a seed, and written byte by byte as joblib writes them."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from dgrasp.types import Array, GraspLabel, StartPose

WRAPPER = b"cjoblib.numpy_pickle\nNumpyArrayWrapper\n)\x81"
PALM = np.array([[0.09, 0.02, 0.0], [0.095, 0.0, 0.0], [0.09, -0.02, 0.0], [0.08, -0.04, 0.0], [0.03, 0.04, 0.01]])
"""Knuckles of a made-up hand in its wrist frame, m."""


def text(value: str) -> bytes:
    """A text as a pickle opcode."""
    raw = value.encode()
    return b"X" + struct.pack("<I", len(raw)) + raw


def dtype_opcodes(dtype: np.dtype[Any]) -> bytes:
    """A numpy dtype, by REDUCE and BUILD as numpy pickles it."""
    order = "|" if dtype.itemsize == 1 else "<"
    return (b"cnumpy\ndtype\n(" + text(dtype.str[1:]) + b"\x89\x88tR"
            b"(K\x03" + text(order) + b"NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb")


def array_opcodes(array: Array, aligned: bool, before: bytes = b"") -> bytes:
    """An array: the wrapper, its state, and the raw bytes; `aligned` as newer joblib pads them."""
    shape = b"(" + b"".join(b"J" + struct.pack("<i", n) for n in array.shape) + b"t"
    state = (b"}(" + text("subclass") + b"cnumpy\nndarray\n" + text("shape") + shape + text("order") + text("C")
             + text("dtype") + dtype_opcodes(array.dtype) + text("allow_mmap") + b"\x88")
    if aligned:
        state += text("numpy_array_alignment_bytes") + b"K\x10"
    padding = b"\x07" + b"\xff" * 7 if aligned else b""
    return WRAPPER + state + before + b"ub" + padding + array.tobytes()


def opcodes(value: Any, aligned: bool = False) -> bytes:
    """The opcodes of a dictionary, list, text, whole number or array."""
    if isinstance(value, dict):
        return b"}(" + b"".join(opcodes(k, aligned) + opcodes(v, aligned) for k, v in value.items()) + b"u"
    if isinstance(value, list):
        return b"](" + b"".join(opcodes(v, aligned) for v in value) + b"e"
    if isinstance(value, np.ndarray):
        return array_opcodes(value, aligned)
    return text(value) if isinstance(value, str) else b"J" + struct.pack("<i", value)


def dump(path: Path, value: Any, aligned: bool = False) -> Path:
    """Write `value` as a joblib file."""
    path.write_bytes((b"\x80\x04" if aligned else b"\x80\x03") + opcodes(value, aligned) + b".")
    return path


def _poses(rng: np.random.Generator, n: int) -> tuple[Array, Array, Array]:
    """qpos (n, 51), key points (n, 21, 3), object poses (n, 7) with unit quaternions w, x, y, z."""
    qpos = np.concatenate([rng.uniform(-0.5, 0.5, (n, 3)), rng.uniform(-1.5, 1.5, (n, 48))], axis=1)
    local = np.zeros((n, 21, 3))
    for finger in range(5):
        for joint in range(4):
            local[:, 1 + 4 * finger + joint] = PALM[finger] * (1.0 + 0.3 * joint)
    rotation = Rotation.from_euler("XYZ", qpos[:, 3:6]).as_matrix()
    joints = np.einsum("nij,nkj->nki", rotation, local) + qpos[:, None, :3]
    quaternion = Rotation.random(n, random_state=rng).as_quat()[:, [3, 0, 1, 2]]
    return qpos, joints, np.concatenate([rng.uniform(-0.5, 0.5, (n, 3)), quaternion], axis=1)


def dexycb_content(seed: int = 0, objects: tuple[int, ...] = (12, 3), n: int = 2) -> dict[int, dict[str, Array]]:
    """The content of a file of the DexYCB layout: `n` labels of each object."""
    rng = np.random.default_rng(seed)
    content = {}
    for key in objects:
        qpos, joints, pose = _poses(rng, n)
        start, _, start_pose = _poses(rng, n)
        contacts = (rng.random((n, 16)) < 0.5).astype(float)
        content[key] = {
            "final_qpos": qpos, "final_pose": qpos[:, 3:].copy(), "final_ee": joints.reshape(n, 63),
            "final_obj_pos": pose, "final_contacts": contacts, "qpos_reset": start, "obj_pose_reset": start_pose,
            "obj_idx_stacked": np.full(n, key - 1, dtype=np.int32),
        }
    return content


def static_content(seed: int = 0, objects: tuple[int, ...] = (12, 3), n: int = 2) -> dict[int, dict[str, Any]]:
    """The content of a file of the GraspTTA and ContactOpt layout."""
    content: dict[int, dict[str, Any]] = {}
    for key, arrays in dexycb_content(seed, objects, n).items():
        content[key] = {
            "final_qpos": arrays["final_qpos"], "final_wpos": arrays["final_ee"], "final_obj": arrays["final_obj_pos"],
            "final_contacts": arrays["final_contacts"], "obj_idx": arrays["obj_idx_stacked"],
            "train_list": list(range(n)),
        }
    return content


def make_labels(n: int = 4, hand: str = "free", seed: int = 0) -> list[GraspLabel]:
    """Made-up labels of two objects, every other one with a start."""
    rng = np.random.default_rng(seed)
    qpos, joints, _ = _poses(rng, n)
    T = np.tile(np.eye(4), (4, n, 1, 1))
    T[:, :, :3, :3] = Rotation.random(4 * n, random_state=rng).as_matrix().reshape(4, n, 3, 3)
    T[0, :, :3, 3] = qpos[:, :3]
    T[1:, :, :3, 3] = rng.uniform(-1.0, 1.0, (3, n, 3))
    names = ("004_sugar_box", "025_mug")
    return [
        GraspLabel(
            object_id=names[2 * i // n], hand_pose=qpos[i, 6:], T_WH=T[0, i], T_WO=T[1, i], joints_W=joints[i],
            goal_contacts=rng.random(16) < 0.5,
            start=StartPose(T[2, i], T[3, i], rng.uniform(-1.0, 1.0, 45)) if i % 2 else None,
            hand=hand, source="made up", index=i % ((n + 1) // 2), on_table=bool(i % 2),
        )
        for i in range(n)
    ]
