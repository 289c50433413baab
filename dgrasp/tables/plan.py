"""The tables' definitions: the runs to train, the evaluations, and the paper's numbers if it has any."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dgrasp.config.names import TABLES
from dgrasp.eval.paper import MOTION_OBJECTS, paper_column, paper_tables
from dgrasp.labels.sources import SOURCES
from dgrasp.labels.splits import UNSEEN
from dgrasp.methods import FlatRl, LearnedMotion
from dgrasp.objects.names import YCB_NAMES

GRASP_METRICS = ("success", "sim_dist_mm_per_step", "interpenetration_shell_cm3")
ABLATION_METRICS = ("success", "sim_dist_mm_per_step", "contact_ratio")
MOTION_METRICS = ("mpe_m", "geodesic_rad")
ABLATION_OBJECTS = ("002_master_chef_can", "004_sugar_box", "052_extra_large_clamp")
"""A cylinder, a box and a complex object (supplement, "Ablations")."""
_ABLATIONS = {
    "no_contact_reward": ("w/o ContactRew", ("env.reward.contact=0.0", "env.reward.impulse=0.0")),
    "no_goal_space": ("w/o GoalSpace", ("env.goal_space=false",)),
    "no_feature_layer": ("w/o FeatLayer", ("env.features=full_state",)),
    "no_wrist_guidance": ("w/o WristGuidance", ("env.wrist=residual",)),
    "ours": ("Ours", ()),
}

RECIPE_OBJECTS = ("004_sugar_box", "021_bleach_cleanser")
RECIPE_METRICS = ("success", "label_distance_mm", "label_angles_deg")
FAST = "cfg/fast.yaml"
_INGREDIENTS = {
    "fast": ("cfg/fast.yaml", FAST, ()),
    "no_hold": ("w/o hold phase", FAST, ("env.hold.first_step=null", "env.reward.hold=0.0")),
    "unscaled": ("w/o scaled features", FAST, ("env.scaled_features=false",)),
    "blind_critic": ("w/o critic's features", FAST, ("env.critic_features=false",)),
    "raw_returns": ("w/o normalised returns", FAST, ("ppo.normalise_returns=false",)),
    "clipped_value": ("clipped value loss", FAST, ("ppo.clipped_value_loss=true",)),
    "clipped_together": ("gradients clipped together", FAST, ("ppo.separate_clipping=false",)),
    "paper_gamma": ("gamma 0.996", FAST, ("ppo.gamma=0.996",)),
    "paper_update": ("the paper's updates", FAST, (
        "ppo.desired_kl=0.01", "ppo.update_epochs=4", "ppo.minibatches=4", "ppo.advantages_per_minibatch=false",
        "ppo.output_gain=1.4142135623730951")),
    "paper_network": ("128 x 128", FAST, ("ppo.hidden=[128, 128]",)),
    "faithful": ("faithful physics", FAST, ("physics.preset=faithful",)),
    "large_epochs": ("all labels in each epoch", FAST, ("labels.per_epoch=null",)),
    "long": ("episodes of 200 steps", FAST, ("env.episode_steps=200", "env.lengthens_by=0")),
    "paper_pose": ("the paper's pose weight", FAST, ("env.reward.pose=0.1",)),
    "paper": ("cfg/dexycb.yaml", "cfg/dexycb.yaml", ()),
}  # fmt: skip
"""Key -> a row's name, config file, and the overrides that change it."""


@dataclass(frozen=True)
class Trained:
    """A training run.

    key: the name of its folder. overrides: its differences from the recipe. cfg: a config file to use in place of the
    recipe's. policy: the run whose policy it builds on, passed to it as `motion.policy`.
    """

    key: str
    overrides: tuple[str, ...] = ()
    cfg: str | None = None
    policy: Trained | None = None


@dataclass(frozen=True)
class Trial:
    """One evaluation.

    method: a name in `dgrasp.methods.METHODS`. run: the training run of its policy, if it needs one. overrides: the
    choice of labels and objects, and keys of the evaluation.
    """

    method: str
    run: Trained | None
    overrides: tuple[str, ...]


@dataclass(frozen=True)
class Line:
    """A row of a table: the labels of all its trials together. paper: the paper's numbers, metric -> value."""

    group: str
    name: str
    trials: tuple[Trial, ...]
    paper: Mapping[str, float]


@dataclass(frozen=True)
class Plan:
    """A table."""

    name: str
    title: str
    metrics: tuple[str, ...]
    lines: tuple[Line, ...]

    @property
    def of_paper(self) -> bool:
        """Whether the paper has this table."""
        return any(line.paper for line in self.lines)


ALL_OBJECTS = Trained("all_objects")


def per_object(name: str) -> Trained:
    """The training run of a policy for one object."""
    return Trained(f"object_{name}", (f"labels.objects=[{name}]",))


def _numbers(entry: Mapping[str, Any]) -> dict[str, float]:
    named = {"success": "success", "interpenetration_cm3": "interpenetration_shell_cm3", "mpe": "mpe_m",
             "geodesic_rad": "geodesic_rad", "contact_ratio": "contact_ratio"}  # fmt: skip
    numbers = {ours: float(entry[theirs]) for theirs, ours in named.items() if theirs in entry}
    if "sim_dist" in entry:
        numbers["sim_dist_mm_per_step"] = float(entry["sim_dist"][0])
    return numbers


def _grasp() -> Plan:
    lines = []
    methods = {"gt_pd": ("GT+PD", "pd", None), "gt_ik": ("GT+IK", "ik", None), "policy": ("Ours", "ours", ALL_OBJECTS)}
    for source in SOURCES:
        for split, table in paper_tables().get(source, {}).items():
            labels = (f"labels.source={source}", f"labels.split={split}")
            for method, (name, column, run) in methods.items():
                if paper_column(source, split, method) is not None:
                    trial = Trial(method, run, labels)
                    lines.append(Line(f"{source} {split}", name, (trial,), _numbers(table["average"][column])))
    return Plan("grasp", "Grasps: stability and interpenetration", GRASP_METRICS, tuple(lines))


def _motion() -> Plan:
    paper, objects = paper_tables()["motion"], (f"labels.objects=[{', '.join(MOTION_OBJECTS)}]",)
    flat = Trained("flat_rl", objects, FlatRl.cfg)
    learned = Trained("learned_motion", objects, LearnedMotion.cfg, ALL_OBJECTS)
    rows = (("flat_rl", "Flat-RL", Trial("flat_rl", flat, objects)),
            ("static_grasp", "Ours+static grasp", Trial("static_grasp", ALL_OBJECTS, objects)),
            ("learned_policy", "Ours+learned policy", Trial("learned_motion", learned, objects)),
            ("ours", "Ours", Trial("policy", ALL_OBJECTS, objects)))  # fmt: skip
    lines = tuple(Line("six objects", name, (trial,), _numbers(paper[key])) for key, name, trial in rows)
    return Plan("motion", "Motion synthesis", MOTION_METRICS, lines)


def _ablation() -> Plan:
    lines = []
    for key, (name, overrides) in _ABLATIONS.items():
        trials = []
        for item in ABLATION_OBJECTS:
            base = per_object(item)
            run = base if key == "ours" else Trained(f"{key}_{item}", base.overrides + overrides)
            trials.append(Trial("policy", run, (*base.overrides, *overrides)))
        lines.append(Line("three objects, train", name, tuple(trials), _numbers(paper_tables()["ablation"][key])))
    return Plan("ablation", "Ablations: policies of one object each", ABLATION_METRICS, tuple(lines))


def _unseen() -> Plan:
    lines = []
    for k in UNSEEN:
        run = Trained(f"unseen_{k}", (f"labels.objects=[seen_{k}]",))
        paper = paper_tables()["unseen_objects"][f"test_set_{k}"]["average"]
        for key, name, method in (("pd", "GT+PD", "gt_pd"), ("ik", "GT+IK", "gt_ik"), ("ours", "Ours", "policy")):
            # The paper counts all labels of the held-out objects, from both splits.
            which = [(f"labels.objects=[unseen_{k}]", f"labels.split={split}") for split in ("train", "test")]
            trials = tuple(Trial(method, run if method == "policy" else None, labels) for labels in which)
            lines.append(Line(f"test set {k}", name, trials, _numbers(paper[key])))
    return Plan("unseen", "Unseen objects: six sets of three, held out in training", GRASP_METRICS, tuple(lines))


def _scope() -> Plan:
    lines = []
    for split in ("train", "test"):
        paper = paper_tables()["policy_scope"][split]
        alone = tuple(
            Trial("policy", per_object(name), (f"labels.objects=[{name}]", f"labels.split={split}"))
            for name in paper_tables()["dexycb"]["train"]
            if name in YCB_NAMES.values()
        )
        lines.append(Line(f"dexycb {split}", "Ours, a policy per object", alone, _numbers(paper["per_object"])))
        together = (Trial("policy", ALL_OBJECTS, (f"labels.split={split}",)),)
        lines.append(Line(f"dexycb {split}", "Ours, one for all objects", together, _numbers(paper["all_objects"])))
    return Plan("scope", "One policy for all objects, or one per object", GRASP_METRICS, tuple(lines))


def _recipe() -> Plan:
    objects = f"labels.objects=[{', '.join(RECIPE_OBJECTS)}]"
    lines = []
    for key, (name, cfg, overrides) in _INGREDIENTS.items():
        # The checkpoint carries changed features to the test, so the trial needs no overrides for them.
        trial = Trial("policy", Trained(f"recipe_{key}", (objects, *overrides), cfg), (objects,))
        lines.append(Line(f"{len(RECIPE_OBJECTS)} objects, train", name, (trial,), {}))
    return Plan("recipe", "Contribution of each ingredient of cfg/fast.yaml", RECIPE_METRICS, tuple(lines))


_PLANS = {"grasp": _grasp, "motion": _motion, "ablation": _ablation, "unseen": _unseen, "scope": _scope,
          "recipe": _recipe}  # fmt: skip
NAMES = TABLES


def plans(name: str) -> list[Plan]:
    """The table called `name` (one of `NAMES`), or for "all" the tables of the paper."""
    return [make() for key, make in _PLANS.items() if name == key or (name == "all" and key != "recipe")]
