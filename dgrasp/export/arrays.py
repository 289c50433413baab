"""A sequence as plain arrays for other programs: joint angles, poses, contacts, forces, and MANO's parameters."""

from __future__ import annotations

import io
import json
from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.export.sequence import StoredSequence
from dgrasp.hand.layout import N_WRIST
from dgrasp.hand.mano.pose import mano_pose
from dgrasp.hand.surface import mano_of_hand
from dgrasp.types import Array
from dgrasp.view.meshes import table_tops
from raisim_like.rotations import quaternion_from_matrix

UNITS = "m, rad, s, N; world frame, z up; quaternions w, x, y, z; Euler angles intrinsic XYZ"


def npz_bytes(sequence: StoredSequence, mano: Path | None = None) -> bytes:
    """The bytes of an .npz: the arrays of `sequence_arrays`, and `meta`, a JSON text with names, units and origin."""
    record, about = sequence.record, sequence.about
    meta = {
        "format": "dgrasp-export", "schema": 1, "units": UNITS, "object": record.label.object_id,
        "index": record.label.index, "label_source": record.label.source, "hand": record.label.hand,
        "method": about["method"], "engine": about["engine"], "data": about["data"], "row": about["row"],
        "dt": record.dt, "window_start": record.window_start, "terminated": record.terminated,
        "joints": list(sequence.names.joints), "parts": list(sequence.names.parts),
        "keypoints": list(sequence.names.keypoints), "mano": mano_note(sequence),
    }  # fmt: skip
    stream = io.BytesIO()
    packed: dict[str, Any] = {"meta": np.array(json.dumps(meta, allow_nan=False)), **sequence_arrays(sequence, mano)}
    np.savez_compressed(stream, **packed)
    return stream.getvalue()


def sequence_arrays(sequence: StoredSequence, mano: Path | None = None) -> dict[str, Array]:
    """Arrays of T steps; docs/export.md lists them.

    mano: the MANO file that the hand was made from; `mano_transl` needs it if the sequence does not store the root
    joint. Raises `DataError` if it is another file.
    """
    record = sequence.record
    arrays = {
        "time_s": np.arange(len(record.gc)) * record.dt,
        "joint_angles": record.gc[:, N_WRIST:],
        "wrist_position": record.T_WH[:, :3, 3],
        "wrist_quaternion": quaternion_from_matrix(record.T_WH[:, :3, :3]),
        "object_position": record.T_WO[:, :3, 3],
        "object_quaternion": quaternion_from_matrix(record.T_WO[:, :3, :3]),
        "keypoints": record.joints_W,
        "contacts": np.asarray(record.contacts) > 0,
        "contact_force": record.contact_impulse / sequence.about["timestep_s"],
        "table_contact": np.asarray(record.table_contact, dtype=bool),
        "table_top": table_tops(record, sequence.about["table"]["top_m"], sequence.about["table"]["lowered_m"]),
    }  # fmt: skip
    if record.T_WG is not None:
        arrays["object_target"] = record.T_WG
    return arrays | _mano(sequence, mano)


def mano_note(sequence: StoredSequence) -> str:
    """A remark that explains the arrays' MANO parameters, or why there are none."""
    origin, hand = sequence.about["mano"], sequence.record.label.hand
    if origin is None:
        return f"none: the hand {hand!r} was not made from a MANO file"
    return (f"{origin['side']} hand; mano_hand_pose counts from the flat hand (flat_hand_mean=True), rotation vectors "
            "in MANO's order of fingers; the wrist is at root joint + mano_transl")


def _mano(sequence: StoredSequence, file: Path | None) -> dict[str, Array]:
    from scipy.spatial.transform import Rotation

    origin, record = sequence.about["mano"], sequence.record
    if origin is None:
        return {}
    # MANO layers expect at least ten betas; zeros are the mean shape.
    betas = np.zeros(max(10, len(origin["betas"])))
    betas[: len(origin["betas"])] = origin["betas"]
    arrays = {
        "mano_global_orient": Rotation.from_matrix(record.T_WH[:, :3, :3]).as_rotvec(),
        "mano_hand_pose": mano_pose(record.gc[:, N_WRIST:]),
        "mano_betas": betas,
    }
    root = origin.get("root_joint")
    if file is not None:
        root = mano_of_hand(file, sequence.meshes.chain.offsets, record.label.hand, origin)[2][0]
    if root is not None:
        arrays["mano_transl"] = record.T_WH[:, :3, 3] - np.asarray(root)
    return arrays
