"""How a computation is run and remembered: outcomes, records, files, executors, progress."""
