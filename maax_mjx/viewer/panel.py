"""The controls beside a world that is played in."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from maax_mjx.common.params import DomainParams, Parameter
from maax_mjx.viewer.keyboard import Keyboard

NOBODY = "nobody"
PAUSE, STEP, NEXT = "Space", "Period", "KeyN"
MEANING = "**Space** pauses, **.** is one step, **N** the next world"


class Panel:
    """Buttons, sliders and keys of a page, which only say what is wanted.

    Args:
        server: of viser.
        agents: names of the agents.
        agent: who is steered first.
        parameters: what worlds are drawn from.
        params: their ranges at first.
        senses: those that can be shown, and whether they are at first.
        keys: further keys to listen to, by code.
        help: what they do, as Markdown.

    Attributes:
        paused: whether the world stands still.
        keyboard: the keys.
    """

    def __init__(
        self,
        server: Any,
        agents: Sequence[str],
        agent: str,
        parameters: Collection[Parameter],
        params: DomainParams,
        senses: dict[str, bool],
        keys: Collection[str],
        help: str,
    ):
        self.paused = False
        self._params, self._changed, self._steps, self._next = params, False, 0, False
        gui = server.gui
        # Beside the world, and always there: what keys say goes through it.
        gui.main_panel.dock_right()
        gui.configure_theme(show_logo=False, show_share_button=False)
        self._agents = [*agents, NOBODY]
        self._words = gui.add_markdown("")
        self._agent = gui.add_dropdown("Steer", self._agents, initial_value=agent)
        gui.add_markdown(f"{help}. {MEANING}.")
        self._pause = gui.add_button("Pause")
        self._pause.on_click(lambda _: self._toggle())
        gui.add_button("One step").on_click(lambda _: self._one_step())
        gui.add_button("Next world").on_click(lambda _: self._ask_next())
        self._senses = {name: gui.add_checkbox(f"Show {name}", on) for name, on in senses.items()}
        self.keyboard = Keyboard(server, [*keys, PAUSE, STEP, NEXT])
        vary = [parameter for parameter in parameters if _has_room(parameter)]
        if vary:
            with gui.add_folder("Worlds, from the next one on", expand_by_default=False):
                for parameter in vary:
                    self._slider(gui, parameter, np.asarray(params[parameter.name]))

    def _slider(self, gui: Any, parameter: Parameter, now: np.ndarray) -> None:
        low, high = parameter.bound
        whole = parameter.dtype == jnp.int32
        kind = int if whole else float
        step = 1 if whole else (high - low) / 100
        slider = gui.add_multi_slider(
            parameter.name, kind(low), kind(high), step, tuple(kind(x) for x in np.clip(now, low, high))
        )

        def moved(_: Any) -> None:
            self._params = self._params.replace(**{parameter.name: tuple(slider.value)})
            self._changed = True

        slider.on_update(moved)

    def _toggle(self) -> None:
        self.paused = not self.paused
        self._pause.label = "Go on" if self.paused else "Pause"

    def _one_step(self) -> None:
        if not self.paused:
            self._toggle()
        self._steps += 1

    def _ask_next(self) -> None:
        self._next = True

    def press(self, key: str) -> None:
        """Does what a key is for, if it is one of the panel's."""
        acts = {PAUSE: self._toggle, STEP: self._one_step, NEXT: self._ask_next}
        if key in acts:
            acts[key]()

    @property
    def slot(self) -> int:
        """The slot of the agent that is steered, -1 for nobody."""
        found = self._agents.index(self._agent.value)
        return -1 if found == len(self._agents) - 1 else found

    def shows(self, sense: str) -> bool:
        """Whether a sense is to be shown."""
        return sense in self._senses and bool(self._senses[sense].value)

    def steps(self) -> bool:
        """Whether a step is due: time goes on, or one was asked for."""
        if not self.paused:
            return True
        due, self._steps = self._steps > 0, max(self._steps - 1, 0)
        return due

    def next_world(self) -> bool:
        """Whether another world was asked for, once."""
        asked, self._next = self._next, False
        return asked

    @property
    def changed(self) -> bool:
        """Whether ranges were moved since `params` was read."""
        return self._changed

    def params(self) -> DomainParams:
        """The ranges as the sliders are."""
        self._changed = False
        return self._params

    def say(self, words: str) -> None:
        """Shows words, as Markdown."""
        if self._words.content != words:
            self._words.content = words


def _has_room(parameter: Parameter) -> bool:
    """Whether a range can be set, with a slider."""
    low, high = parameter.bound
    return bool(np.isfinite([low, high]).all() and low != high)
