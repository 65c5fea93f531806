"""``python -m isogi_server`` is the ``isogi`` command."""

from isogi_server.cli.command import main

if __name__ == "__main__":
    main()
