"""Digests of the files that options name."""

from pathlib import Path

from identknee.runs.files import digest


def file_digests(**options: str | None) -> dict[str, str]:
    """SHA-256, by option, of those options that name a file rather than something built in."""
    return {
        name: digest(value)
        for name, value in options.items()
        if value is not None and Path(value).suffix == ".toml" and Path(value).is_file()
    }
