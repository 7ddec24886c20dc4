"""Properties that are derived from the compiled model, cached per model."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, Generic, TypeVar, overload

T = TypeVar("T")


class from_model(Generic[T]):
    """A property that is computed once per model; reading it builds the model if needed.

    Decorates methods of modules and environments that read `self.model` or anything derived from it:

        class Door(Module):
            @from_model
            def hinge(self) -> int:
                return self.model.joint("door:hinge").qposadr[0]
    """

    def __init__(self, compute: Callable[[Any], T]):
        self._compute = compute
        self.__doc__ = compute.__doc__

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
            found = build, self._compute(instance)
            instance.__dict__[self._slot] = found
        return found[1]


def without_cached(thing: Any) -> dict[str, Any]:
    """Returns an object's attributes without the values that properties cache, for a copy of the object."""
    cached = {name for name in vars(thing) if isinstance(getattr(type(thing), name, None), cached_property)}
    return {n: value for n, value in vars(thing).items() if not n.startswith("_from_model_") and n not in cached}
