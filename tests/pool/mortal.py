"""An actor that ends its worker. It is apart from the tests, because workers import it, and pytest takes long."""

from __future__ import annotations

import os
from dataclasses import dataclass, field

from dgrasp.rl.collect import Actor
from dgrasp.types import Array


@dataclass(frozen=True)
class Mortal(Actor):
    """Sends a signal to the process that acts for a single environment, in its 20th control step."""

    how: int
    acted: list[int] = field(default_factory=list)

    def means(self, observations: Array, out: Array) -> None:
        if len(observations) == 1:
            self.acted.append(1)
            if len(self.acted) == 20:
                os.kill(os.getpid(), self.how)
        super().means(observations, out)
