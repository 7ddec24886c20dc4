"""Locking objects in place."""

from maax_mjx.wrappers.locks.wrapper import LockObjects, Locks

__all__ = ["LockObjects", "Locks"]
