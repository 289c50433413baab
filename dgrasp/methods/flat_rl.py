"""The baseline Flat-RL: one policy on phi and psi for everything, with the rewards of both, trained end to end."""

from __future__ import annotations

from dgrasp.methods.policy import PolicyMethod
from dgrasp.rl.networks import Policy


class FlatRl(PolicyMethod):
    """Supplement, section B.4: no phases, so its target is there from the first step; `dgrasp.env.target_env.FlatEnv`.

    Trained by `python train.py --cfg cfg/flat_rl.yaml`.
    """

    name = "flat_rl"
    task = "flat"

    def __init__(self, policy: Policy) -> None:
        super().__init__(policy, self.name)
