"""Shared helpers of all rooms: checks, keys, parameters, spaces, arrays, the JAX runtime."""
