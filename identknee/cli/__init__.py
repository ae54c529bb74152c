"""The command line, made from the signatures of the verbs."""
