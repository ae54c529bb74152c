"""What an explanation gains on trials that it was not fitted to."""
