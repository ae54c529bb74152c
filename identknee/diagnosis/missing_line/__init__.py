"""The force that a model lacks, where no known cause explains the data."""
