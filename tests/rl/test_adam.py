"""Our Adam is torch's to the bit, and trains without torch's compiler."""

from __future__ import annotations

import copy
import subprocess
import sys

import torch
from torch import Tensor

from dgrasp.files.paths import shipped_root
from dgrasp.rl.adam import Adam


def parameters() -> list[Tensor]:
    generator = torch.Generator().manual_seed(3)
    return [torch.randn(shape, generator=generator).requires_grad_() for shape in ((4, 3), (4,))]


def descend(optimizer: torch.optim.Adam, steps: int) -> None:
    """Towards zero, by the sum of fourth powers."""
    for _ in range(steps):
        optimizer.zero_grad()
        leaves: list[Tensor] = optimizer.param_groups[0]["params"]
        torch.stack([(leaf**4).sum() for leaf in leaves]).sum().backward()
        optimizer.step()


def test_it_is_torchs_to_the_bit_and_takes_torchs_state() -> None:
    ours, theirs = parameters(), parameters()
    mine, reference = Adam(ours, lr=0.1, betas=(0.9, 0.98)), torch.optim.Adam(theirs, lr=0.1, betas=(0.9, 0.98))
    descend(mine, 5)
    descend(reference, 5)
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
    assert not torch.equal(ours[0], parameters()[0])
    resumed = Adam(ours, lr=1.0)
    resumed.load_state_dict(copy.deepcopy(reference.state_dict()))
    assert resumed.param_groups[0]["lr"] == 0.1
    descend(resumed, 5)
    descend(reference, 5)
    assert all(torch.equal(a, b) for a, b in zip(ours, theirs, strict=True))
    states = [optimizer.state_dict()["state"] for optimizer in (mine, reference)]
    for moments, other in zip(*(state.values() for state in states), strict=True):
        assert moments.keys() == other.keys() == {"step", "exp_avg", "exp_avg_sq"}


_CODE = """
import sys
import torch
from dgrasp.config.sections import PpoConfig
from dgrasp.rl.networks import ActorCritic
from dgrasp.rl.ppo import Ppo
ppo = Ppo(ActorCritic(4, 2, [8], 0.5, torch.Generator()), PpoConfig())
ppo.optimizer.zero_grad()
ppo.model.value(torch.ones(1, 4)).sum().backward()
ppo.optimizer.step()
ppo.optimizer.load_state_dict(ppo.optimizer.state_dict())
print([name for name in ("torch._dynamo", "sympy") if name in sys.modules])
"""


def test_a_training_imports_no_compiler() -> None:
    done = subprocess.run(
        [sys.executable, "-c", _CODE], capture_output=True, text=True, check=True,
        env={"PYTHONPATH": str(shipped_root()), "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.stdout == "[]\n"
