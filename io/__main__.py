"""`python -m quadrig.io` is `rig`."""

from quadrig.io.commands.main import main

if __name__ == "__main__":
    main()
