"""`python -m maax_mjx`: the command `maax-mjx`."""

from maax_mjx.cli import main

if __name__ == "__main__":
    main()
