"""What all policies of trained networks are."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Any, Self

from maax_mjx.core.env import Environment
from maax_mjx.tasks import config_of, is_in_a_file, make
from maax_mjx.tasks.config import recorded_fields


class TrainedPolicy(ABC):
    """A network that learnt to play a game. It plays wherever policies are taken; its memory is looked after.

    Attributes:
        play: `(state, key, memory, params) -> (action, memory)` for one world; equal ones compile once.
        params: its weights.
        game: name and config of the game that it learnt, as `Checkpoints.about` has them; None if `maax.make` did not
            make it.
        steps: env steps that it learnt from, as far as that is known.
    """

    play: Callable[..., Any]
    params: Any
    game: dict[str, Any] | None
    steps: int

    @abstractmethod
    def memory(self, n_worlds: int) -> Any:
        """Returns what it remembers at the beginning of episodes, (n_worlds, n_agents, m)."""

    @abstractmethod
    def greedy(self) -> Self:
        """Returns the policy that takes the most likely actions."""

    @abstractmethod
    def on(self, env: Environment) -> Self:
        """Returns the policy as it plays an environment.

        Raises:
            ValueError: an environment that it cannot play.
        """

    def make_env(self, **overrides: Any) -> Environment:
        """Makes the game that it learnt.

        Args:
            **overrides: fields of its config to change.

        Raises:
            ValueError: a policy of a game that `maax.make` did not make, or what `maax.make` refuses.
        """
        if self.game is None:
            raise ValueError(
                "make_env: got a policy of an environment of one's own; takes one of a registered game. What plays it "
                "takes that environment: training.evaluate(policy, env=env)"
            )
        try:
            config = config_of(self.game["game"])
        except ValueError as error:
            if is_in_a_file(self.game["game"]):  # which says that there is no such file here
                raise
            raise ValueError(
                f"{error}; of a game in a file of one's own, import the file first, or train it by its file's name, "
                f"my_game.py:{self.game['game']}"
            ) from None
        return make(self.game["game"], **(recorded_fields(config, self.game) | overrides))
