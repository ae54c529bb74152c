"""The command, also as ``python -m identknee``."""

from identknee.cli.main import main

if __name__ == "__main__":
    main()
