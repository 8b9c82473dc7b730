"""Scores of bundles and methods, and the documents that report them."""
