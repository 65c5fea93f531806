"""``python -m server`` is the ``isogi`` command."""

from server.cli.command import main

if __name__ == "__main__":
    main()
