"""Values that follow from the compiled model: worked out when they are first read, and again for another model."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, Protocol, TypeVar, overload

T = TypeVar("T")


class Built(Protocol):
    """Something that hangs on a compiled model.

    Attributes:
        build: an object that stands for one composition of modules; another after one was added.
    """

    @property
    def build(self) -> object: ...


class from_model(Generic[T]):
    """A property that is worked out once for every model, which reading it builds where that was not done yet.

    Decorates methods of modules and environments, which read `self.model` and what else hangs on it:

        class Door(Module):
            @from_model
            def hinge(self) -> int:
                return self.model.joint("door:hinge").qposadr[0]
    """

    def __init__(self, work_out: Callable[[Any], T]):
        self._work_out = work_out
        self.__doc__ = work_out.__doc__

    def __set_name__(self, owner: type, name: str) -> None:
        self._slot = f"_from_model_{name}"

    @overload
    def __get__(self, instance: None, owner: type) -> from_model[T]: ...
    @overload
    def __get__(self, instance: Any, owner: type) -> T: ...
    def __get__(self, instance: Any, owner: type) -> T | from_model[T]:
        if instance is None:
            return self
        build, found = instance.build, instance.__dict__.get(self._slot)
        if found is None or found[0] is not build:
            found = build, self._work_out(instance)
            instance.__dict__[self._slot] = found
        return found[1]


def without_worked_out(attributes: dict[str, Any]) -> dict[str, Any]:
    """An object's attributes but for what `from_model` keeps among them: what a copy of it takes over."""
    return {name: value for name, value in attributes.items() if not name.startswith("_from_model_")}
