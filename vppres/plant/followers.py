"""What the plant asks of every kind of flexible power."""

from __future__ import annotations

from typing import Protocol

from vppres.core.arrays import Flags, Floats


class Followers(Protocol):
    """The n units of a kind: what they do of what is asked. Power is what they take, (n,)."""

    def on(self, served: Flags) -> Flags:
        """Units that are connected, if these customers are served."""
        ...

    def follow(
        self, t: int, wanted_kw: Floats, running: Flags, served: Flags
    ) -> tuple[Floats, Flags]:
        """Power nearest to what is wanted, and which units run, of a kind that is started."""
        ...

    def spare_kw(self, taken_kw: Floats, running: Flags) -> Floats:
        """By how much each can give less without stopping."""
        ...

    def advance(self, t: int, taken_kw: Floats, running: Flags) -> None:
        """The state at the end of a step."""
        ...
