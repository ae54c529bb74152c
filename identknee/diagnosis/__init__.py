"""What a fitted model gets wrong, its cause named or honestly not, and what naming it gains."""
