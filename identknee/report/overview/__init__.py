"""What all results of one data set say together: a verdict, a table, the fits, the next tests."""
