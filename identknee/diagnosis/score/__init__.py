"""How strongly residuals speak against a model, for each of many causes, and where."""
