"""Problems whose profile interval is known, for this and any other tool to be run against."""
