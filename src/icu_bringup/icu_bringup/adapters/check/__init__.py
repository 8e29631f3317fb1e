"""A replay as processes, and the files of an expectation and of a report."""
