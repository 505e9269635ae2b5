"""Entry point ``python -P -m services.cli`` of child processes: -P prevents imports from the current folder."""

from services.cli.app import main

if __name__ == "__main__":
    main()
