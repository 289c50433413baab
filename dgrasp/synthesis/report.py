"""Figures of synthesised labels: diversity, penetration, contacts, and how many hold under gt_pd."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from dgrasp.hand.store import NamedHand
from dgrasp.hand.surface import hand_surface
from dgrasp.labels.quality.measure import measure_labels
from dgrasp.objects.body import object_body
from dgrasp.objects.model import ObjectModel
from dgrasp.synthesis.synthesiser import Synthesised
from dgrasp.types import Array, GraspLabel


def figures(made: Synthesised, hand: NamedHand, model: ObjectModel) -> dict[str, Any]:
    """The figures of one object's labels, as plain values.

    held: how many labels hold. found_held: the share of all tried grasps that held, before the choice.
    best_quarter_held: the share that hold of the quarter with the best geometry, by `Synthesised.quality`.
    penetration_cm3: mean penetration of the hand's best surface and the object's mesh. touching, contacts: mean numbers
    of parts that touch and of goal contacts (within 0.015 m). diversity_deg, diversity_mm: see `joint_distances`.
    """
    surface = hand_surface(hand.model, None, hand.meta)
    findings = measure_labels(made.labels, hand.model, surface, {model.name: object_body(model, Path()).body})
    volumes = [f.penetration_cm3 for f in findings if f.penetration_cm3 is not None]
    best = np.argsort(-made.quality, kind="stable")[: max(1, len(made.labels) // 4)]
    degrees, millimetres = joint_distances(made.labels)
    return {
        "held": int(made.held.sum()),
        "found_held": made.found_held,
        "best_quarter_held": float(made.held[best].mean()),
        "penetration_cm3": float(np.mean(volumes)) if volumes else 0.0,
        "touching": float(made.touching.mean()),
        "contacts": float(np.mean([label.goal_contacts.sum() for label in made.labels])),
        "diversity_deg": degrees,
        "diversity_mm": millimetres,
    }


def joint_distances(labels: list[GraspLabel]) -> tuple[float, float]:
    """Distances between the grasps of one object, as means over all pairs; 0 for a single grasp.

    The first is the root mean square over the finger angles, degrees. The second is the mean over the key points in the
    object's frame, mm.
    """
    if len(labels) < 2:
        return 0.0, 0.0
    pose = np.stack([label.hand_pose for label in labels])
    points = np.stack([(label.joints_W - label.T_WO[:3, 3]) @ label.T_WO[:3, :3] for label in labels])
    first, second = np.triu_indices(len(labels), 1)
    angles: Array = np.sqrt(((pose[first] - pose[second]) ** 2).mean(axis=1))
    apart: Array = np.linalg.norm(points[first] - points[second], axis=2).mean(axis=1)
    return float(np.degrees(angles.mean())), float(1000.0 * apart.mean())
