"""What is given with a knee and not known exactly, as parameters with priors."""
