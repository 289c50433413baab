"""Names and orders of the 51-DoF hand: the one place that fixes them.

The order is that of the paper's observations and of the authors' labels: wrist first, then index, middle,
ring, little and thumb, each from the palm outwards. MANO's own files list the little finger before the
ring finger; `MANO_FINGERS` is the order to convert from.
"""

from __future__ import annotations

FINGERS = ("index", "middle", "ring", "little", "thumb")
MANO_FINGERS = ("index", "middle", "little", "ring", "thumb")
SEGMENTS = ("proximal", "middle", "distal")

PARTS = ("palm", *(f"{finger}_{segment}" for finger in FINGERS for segment in SEGMENTS))
"""The 16 rigid parts; contacts and impulses are arrays in this order."""

KEYPOINTS = ("wrist", *(f"{finger}_{joint}" for finger in FINGERS for joint in (*SEGMENTS, "tip")))
"""The 21 key points: the wrist, and per finger its three joints and its tip."""

TIPS = tuple(i for i, name in enumerate(KEYPOINTS) if name.endswith("_tip"))
"""Indices of the five fingertips among the key points."""

DOF_NAMES = (
    *(f"wrist_t{axis}" for axis in "xyz"),
    *(f"wrist_r{axis}" for axis in "xyz"),
    *(f"{part}_r{axis}" for part in PARTS[1:] for axis in "xyz"),
)
"""The 51 generalised coordinates: 3 translations, then intrinsic XYZ Euler angles of wrist and joints."""

N_DOF = len(DOF_NAMES)
N_FINGER_DOF = N_DOF - 6
N_PARTS = len(PARTS)
N_KEYPOINTS = len(KEYPOINTS)

DISTAL_PARTS = [i for i, name in enumerate(PARTS) if name.endswith("_distal")]
"""Indices of the five fingers' last parts, order of `FINGERS`."""

PART_PARENT = (-1, *(0 if segment == "proximal" else 3 * f + s for f in range(5) for s, segment in enumerate(SEGMENTS)))
"""Index of each part's parent part; the palm has none (-1)."""
