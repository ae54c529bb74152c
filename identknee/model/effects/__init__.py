"""Physical effects that extend the laxity model: one file a family."""
