"""What every room may use: checks, keys, parameters, spaces, arrays, the JAX runtime."""
