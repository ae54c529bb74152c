"""The self-contained HTML report of a folder of results."""
