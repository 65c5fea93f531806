"""``python -m server`` is the ``isogi`` command in a checkout."""

from isogi_server.cli.command import main

if __name__ == "__main__":
    main()
