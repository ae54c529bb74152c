"""Where the command `identknee` begins."""

import sys

INTERRUPTED = 130


def main() -> None:
    """Run the command and leave with its exit code."""
    try:
        # Loaded here so that Ctrl-C during the start leaves no traceback either.
        from identknee.cli.app import app

        app(prog_name="identknee")
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
