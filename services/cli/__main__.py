"""``python -P -m services.cli``: how child processes start, so that a folder's own files are never imported."""

from services.cli.app import main

if __name__ == "__main__":
    main()
