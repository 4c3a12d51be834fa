"""One noun of the REST interface a file."""
