"""Many recordings: the plan, engines that carry it out, files that keep the results.

An engine (``local``, ``cluster``) turns recordings into records; a result file (``jsonl``,
``parquet``) keeps records and tells which recordings a second run can skip.
"""
