"""Comparison of a replay's results with an expectation: values, tolerances, rows, reports."""
