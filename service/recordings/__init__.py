"""A whole recording: its options, its windows, its results and the answer in JSON."""
